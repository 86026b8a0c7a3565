// The page: its head, its panels, and what a screen reader is told.
import { useComputed } from "@preact/signals";
import { Adaptations, Chain } from "./adaptations.jsx";
import { clock, withUnit } from "./format.js";
import { KEYS } from "./keys.js";
import { Disturb } from "./disturb.jsx";
import { Knowledge } from "./knowledge.jsx";
import { Events } from "./log.jsx";
import { complaint, connection, dropped, may, order, state } from "./live.js";
import { Scene } from "./scene.jsx";
import { adaptations, enlarged, revision, run, tab, time } from "./state.js";
import { theme, toggleTheme } from "./theme.js";
import { Timelines } from "./timelines.jsx";
import { Transport } from "./transport.jsx";
import { Tree } from "./tree.jsx";
import { WhatIf } from "./whatif.jsx";

const PACES = [0, 0.5, 1, 2, 5, 10];

function Live() {
  const { paused, stopped, speed, over, pages } = state.value;
  const can = (what) => may.value.includes(what);
  const paces = [...new Set([...PACES, speed])];
  return (
    <div class="tools" role="group" aria-label="mission">
      <span class={`connection ${connection.value}`} role="status">
        {over ? "over" : connection.value}{paused && `, paused${stopped ? `: ${stopped}` : ""}`}
      </span>
      {dropped.value > 0 && <span class="bad">{dropped.value} updates dropped</span>}
      {pages > 1 && <small>{pages} pages</small>}
      {can("pause") && <button onClick={() => order(paused ? "resume" : "pause")}>{paused ? "Resume" : "Pause"} mission</button>}
      {can("pause") && paused && <button onClick={() => order("step")}>One tick</button>}
      {can("speed") && (
        <select aria-label="speed of the mission" value={speed} onChange={({ target }) => order("speed", { value: Number(target.value) })}>
          {paces.map((one) => <option key={one} value={one}>{one ? `${one}× real time` : "no limit"}</option>)}
        </select>
      )}
    </div>
  );
}

const Row = ({ title, children }) => <tr><th scope="row">{title}</th><td>{children}</td></tr>;

function Results() {
  const result = (revision.value, run.value.of("result").last); // it comes when the run is over, and nothing else with it
  if (!result) return null;
  return (
    <details class="results">
      <summary>{result.success ? "✓" : "✕"} {result.outcome.replaceAll("_", " ")}</summary>
      <div>
        <p>{result.reason}</p>
        <table>
          <tbody>
            {result.figures.map(([words, unit, text]) => <Row key={words + unit} title={words}>{withUnit(text, unit)}</Row>)}
            {Object.entries(run.value.header.settings).map(([name, text]) => <Row key={name} title={name}>{text}</Row>)}
          </tbody>
        </table>
        {run.value.last("problem").map(([key, { words: text }]) => <p key={key} class="bad">{text}</p>)}
      </div>
    </details>
  );
}

function Help() {
  return (
    <>
      <button aria-label="keys" title="keys (?)" onClick={KEYS["?"][2]}>?</button>
      <dialog id="keys" aria-label="keys">
        <table><tbody>{Object.values(KEYS).map(([name, what]) => <Row key={name} title={<kbd>{name}</kbd>}>{what}</Row>)}</tbody></table>
        <form method="dialog"><button>Close</button></form>
      </dialog>
    </>
  );
}

function Head({ note }) {
  const { title, words, task, manager, seed } = run.value.header;
  const other = manager !== "ours" && manager && `manager: ${manager}`;
  const facts = [words, task && `task layer: ${task}`, other, seed !== null && `seed ${seed}`];
  const isDark = theme.value === "dark";
  return (
    <header class="head">
      <h1>{title}</h1>
      <small class="words">{facts.filter(Boolean).join(" · ")}</small>
      <Results />
      {connection.value !== "none" && <Live />}
      <button aria-label={isDark ? "light" : "dark"} title="light or dark (d)" onClick={toggleTheme}>{isDark ? "☀︎" : "☾"}</button>
      <Help />
      {[note, complaint.value].filter(Boolean).map((one) => <p key={one} class="note" role="alert">{one}</p>)}
    </header>
  );
}

/** The panels that share a place. */
const Side = () => ({ whatif: <WhatIf />, log: <Events />, disturb: <Disturb /> })[tab.value] ?? <WhatIf />;

/** What a screen reader is told: the adaptation that came last. */
function Told() {
  const latest = useComputed(() => adaptations.value.findLast(([, one]) => one.t <= time.value)?.[1]).value;
  return <p class="unseen" aria-live="polite">{latest && `Adaptation at ${clock(latest.t)}: ${latest.cause}; ${latest.changed}`}</p>;
}

export function App({ note }) {
  if (!run.value) return <main role="status">{complaint.value || `Connecting to the mission: ${connection.value}.`}</main>;
  return (
    <>
      <Head note={note} />
      <main class={enlarged.value ? "has-large" : ""}>
        <Chain />
        <Adaptations />
        <Scene />
        <Tree />
        <Side />
        <Timelines />
        <Knowledge />
      </main>
      <Transport />
      <Told />
    </>
  );
}
