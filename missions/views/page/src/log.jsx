// The event log: everything that happened, with level, time and text; filtered, searched over time, and where to stop.
import { computed, signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { breakpoints, isCondition, nextTime, suggestions } from "./conditions.js";
import { clock, pretty } from "./format.js";
import { connection, may, order as request, state } from "./live.js";
import { Panel, reveal, Search } from "./parts.jsx";
import { revision, run, seek, selected, time } from "./state.js";

const LEVELS = ["info", "warning", "error"];
const MOST = 300; // entries that are made around the instant shown
const [words, least, isOfElement, condition] = [signal(""), signal("info"), signal(false), signal("")];
const isLive = () => connection.value !== "none" && may.value.includes("break");
const TRACKS = ["event", "taskplan", "adaptation", "disturbance", "problem", "result"];

const all = computed(() => {
  revision.value;
  const entries = TRACKS.flatMap((track) => run.value.last(track).map(([key, { t, level, words: text, verb, changes = [] }]) =>
    ({ id: `${track}${key}`, t, level, text, about: changes.map(([, name]) => name), what: verb?.replaceAll("_", " ") ?? track })));
  return entries.sort((a, b) => a.t - b.t);
});

const shown = computed(() => {
  const wanted = words.value.toLowerCase().split(" ").filter(Boolean);
  const name = isOfElement.value && selected.value !== null ? run.value.name(selected.value) : null;
  return all.value.filter(({ level, text, what, about }) =>
    LEVELS.indexOf(level) >= LEVELS.indexOf(least.value)
    && wanted.every((one) => `${level} ${what} ${text}`.toLowerCase().includes(one))
    && (name === null || about.includes(name) || text.includes(name)));
});

function Entry({ entry: { t, level, text, what, about } }) {
  const go = () => {
    seek(t);
    const isMeant = ([, { name, kind }]) => kind !== "constraint" && (about.includes(name) || text.includes(name));
    const element = run.value.last("element").findLast(isMeant); // an action before what it needs
    if (element) selected.value = element[0];
  };
  return (
    <li class={t > time.value ? "later" : ""}>
      <button class={`plain entry ${level}`} onClick={go}>
        <b>{clock(t)}</b> <span class={`level ${level}`}>{level}</span> <small>{what}</small> <span class="words">{pretty(text)}</span>
      </button>
    </li>
  );
}

/** Search over time, and breakpoints: both by the same condition. */
function Conditions() {
  const text = condition.value.trim();
  const stops = isLive() ? (state.value.breaks ?? []) : breakpoints.value;
  const isMeant = isCondition(text);
  const keep = (texts) => (isLive() ? request("break", { at: texts }) : (breakpoints.value = texts));
  const next = isMeant ? nextTime(text, time.value) : undefined;
  return (
    <div class="conditions">
      <input type="search" list="conditions" aria-label="condition, such as boom failure or battery_level < 0.25"
        placeholder="boom failure, level < 0.25" value={condition.value} onInput={({ target }) => (condition.value = target.value)} />
      <datalist id="conditions">{suggestions().map((one) => <option key={one} value={one} />)}</datalist>
      <button disabled={next === undefined} onClick={() => seek(next)}>Next time</button>
      <button disabled={!isMeant || stops.includes(text)} onClick={() => keep([...stops, text])}>Stop there</button>
      <small role="status">{text && (isMeant ? next === undefined && "not again in this run" : "no such element, status or value")}</small>
      {stops.map((one) => (
        <button key={one} class="stop" aria-label={`remove breakpoint ${one}`} onClick={() => keep(stops.filter((each) => each !== one))}>
          ⏸ {one} ✕
        </button>
      ))}
    </div>
  );
}

export function Events() {
  const list = useRef(null);
  const until = shown.value.findLastIndex(({ t }) => t <= time.value);
  const first = Math.max(0, Math.min(until - MOST / 2, shown.value.length - MOST));
  const bring = () => reveal(list.current, list.current.querySelectorAll("li")[until - first]);
  useEffect(bring, [time.value, words.value]);
  return (
    <Panel id="log" title="Events" aside={<small>{shown.value.length}</small>}>
      <div class="conditions">
        <Search of="events" words={words} />
        <select aria-label="least level" value={least.value} onChange={({ target }) => (least.value = target.value)}>
          {LEVELS.map((one) => <option key={one}>{one}</option>)}
        </select>
        <button aria-pressed={isOfElement.value} title="only what is about the chosen element"
          onClick={() => (isOfElement.value = !isOfElement.value)}>chosen</button>
      </div>
      <Conditions />
      <div class="body" ref={list} tabIndex={0} role="group" aria-label="events">
        <ol>{shown.value.slice(first, first + MOST).map((entry) => <Entry key={entry.id} entry={entry} />)}</ol>
        {shown.value.length === 0 && <p class="muted">No event fits.</p>}
      </div>
    </Panel>
  );
}
