// The instant: the slider over the whole run with its adaptations, and the buttons that move it.
import { isPlaying, speed, SPEEDS, togglePlay } from "./player.js";
import { at, adaptations, chosen, choose, end, follow, isFollowing, leap, percent, run, seek, start, step, time } from "./state.js";
import { clock } from "./format.js";
import { connection } from "./live.js";

/** What is done at the instant shown, in words. */
export function doing() {
  const open = run.value.keys("action").map((key) => at("action", key)).filter((one) => one && one.result === null);
  return open.map((one) => run.value.name(one.action)).join(", ") || "no action";
}

function Ticks() {
  return (
    <div class="ticks" aria-hidden="true">
      {run.value.last("disturbance").map(([key, { t, words }]) => <i key={key} style={{ left: percent(t) }} title={words} />)}
      {adaptations.value.map(([key, one]) => (
        <button key={key} class={`tick ${one.kind} ${chosen.value === key ? "is-chosen" : ""}`} tabIndex={-1}
          style={{ left: percent(one.t) }} title={`${clock(one.t)}: ${one.cause}`} onClick={() => choose(key)} />
      ))}
    </div>
  );
}

const Button = ({ words, press, children }) => <button aria-label={words} title={words} onClick={press}>{children}</button>;

export function Transport() {
  const [playing, words] = isPlaying.value ? ["❚❚", "pause (Space)"] : ["▶︎", "play (Space)"];
  return (
    <section class="transport" aria-label="instant">
      <div class="buttons">
        <Button words="previous adaptation (p)" press={() => leap(-1)}>«</Button>
        <Button words="previous change (←)" press={() => step(-1)}>‹</Button>
        <Button words={words} press={togglePlay}>{playing}</Button>
        <Button words="next change (→)" press={() => step(1)}>›</Button>
        <Button words="next adaptation (n)" press={() => leap(1)}>»</Button>
        <select aria-label="speed of playing" value={speed.value} onChange={({ target }) => (speed.value = Number(target.value))}>
          {SPEEDS.map((one) => <option key={one} value={one}>{one}×</option>)}
        </select>
        {connection.value !== "none" && <button aria-pressed={isFollowing.value} onClick={follow}>Now</button>}
      </div>
      <div class="slider">
        <Ticks />
        <input id="instant" type="range" aria-label="instant shown" aria-valuetext={`${clock(time.value)}, ${doing()}`}
          min={start.value} max={end.value} step="any" value={time.value} onInput={({ target }) => seek(target.valueAsNumber)} />
      </div>
      <output class="clock">{clock(time.value)} <small>/ {clock(end.value)}</small></output>
    </section>
  );
}
