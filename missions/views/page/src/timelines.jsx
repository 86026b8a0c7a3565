// Everything over time on one axis: what was measured, done, chosen, planned; the line of the instant; the chosen chain.
import { useSignal } from "@preact/signals";
import { useEffect, useMemo, useRef } from "preact/hooks";
import { clock, withUnit } from "./format.js";
import { Panel, reveal, stepsBy } from "./parts.jsx";
import { AttributePlot, hovered, SignalPlot } from "./plots.jsx";
import { actionNames, hueOf } from "./scene.jsx";
import { chosen, elements, part, place, revision, run, seek, span, time, zoomed } from "./state.js";

const ROUND = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 36000]; // steps of the axis [s]
const TICKS = 8; // of the axis, at most
const LEAST = 0.01; // part of the axis that has to be dragged over for a zoom
const SAME = 0.05; // part of the axis on which the marks of a chain are one

/** A bar {from, until [s], text, words, hue}; one that is still open goes to the end of its run. */
const bar = (one, from, until, text = "", words = "", hue = undefined) =>
  ({ from: Math.max(from, one.start), until: until ?? one.end, text, words, hue });

/** The lanes with anything in them as [title, bars], in the order in which they are drawn. */
function lanes() {
  const one = run.value;
  const names = actionNames();
  const last = (track) => one.last(track).map(([, value]) => value);
  const known = one.last("element").map(([key]) => [key, one.element(key)]);
  const held = (track, key, text) =>
    one.of(track, key).spans(one.end).filter(([, , value]) => value).map(([from, until]) => bar(one, from, until, text));
  const chosenFor = ([, { name, requires }]) => [name, requires.flatMap((each) => held("selected", each, one.name(each)))];
  const done = last("action").map(({ action, start: from, end: until, result }) =>
    bar(one, from, until, one.name(action), result ?? "", hueOf(names, one.name(action))));
  const isParallel = done.some(({ from }, index) => from < done[index - 1]?.until);
  const switched = known.filter(([key]) => one.of("active", key).times.length > 1);
  const all = [
    ["disturbances", last("disturbance").map(({ t, words }) => bar(one, t, t, "", words, "var(--bad)"))],
    ...(isParallel ? Object.entries(Object.groupBy(done, ({ text }) => `action ${text}`)) : [["actions", done]]),
    ...known.filter(([, { kind }]) => kind === "function" || kind === "component").map(chosenFor),
    ...switched.map(([key, { name }]) => [`${name} runs`, held("active", key, "")]),
    ["reconfiguration plans", last("plan").map(({ words, start: from, end: until, result }) =>
      bar(one, from, until, "", `${words}: ${result ?? "under way"}`))],
    ["planner calls", last("taskplan").map(({ t, level, words }) =>
      bar(one, t, t, "", words, level === "info" ? undefined : "var(--bad)"))],
  ];
  return all.filter(([, bars]) => bars.length);
}

const between = (from, until) => ({ left: place(from), width: `calc(${place(until)} - ${place(from)})` });

const Bar = ({ from, until, text, words, hue }) => (
  <li class={from === until ? "point" : ""} style={{ ...between(from, until), background: hue }}
    title={`${clock(from)} – ${clock(until)} ${text} ${words}`}>
    {text || <span class="unseen">{words || "on"}</span>}
  </li>
);

const Lane = ({ title, bars }) => (
  <div class="lane">
    <span class="name">{title}</span>
    <ol aria-label={title}>{bars.map((one, index) => <Bar key={index} {...one} />)}</ol>
  </div>
);

/** The lanes are drawn anew when there is more to draw, not at each instant. */
function Lanes() {
  const known = revision.value;
  return useMemo(() => lanes().map(([title, bars]) => <Lane key={title} title={title} bars={bars} />), [known, run.value, span.value]);
}

/** The line of the instant, and those of the chosen chain, over all that has the axis. */
function Lines() {
  let last = -1;
  const near = ({ t }) => (last = part(t) - last > SAME ? part(t) : last);
  return (
    <div class="lines" aria-hidden="true">
      {stepsBy(near).map(([along, { t }, words]) => <i key={along} class="step-line" style={{ left: place(t) }}><b>{words}</b></i>)}
      <i class="instant-line" style={{ left: place(time.value) }} />
    </div>
  );
}

/** The axis of time: a tick at each round number, and its name. */
function Ruler() {
  const [from, until] = span.value;
  const step = ROUND.find((one) => (until - from) / one <= TICKS) ?? (until - from) / TICKS;
  const first = Math.ceil(from / step);
  const ticks = Array.from({ length: Math.floor(until / step) - first + 1 }, (_, index) => (first + index) * step);
  return (
    <div class="ruler" aria-hidden="true">
      <ol>{ticks.map((t) => <li key={t} style={{ left: place(t) }}>{from > 1e8 ? clock(t).slice(0, 8) : Number(t.toFixed(6))}</li>)}</ol>
      <span>{from > 1e8 ? "time of day" : "time [s]"}</span>
    </div>
  );
}

/** What is drawn in the time shown, as text with a row for each instant at which a value came. */
function asText(attributes) {
  const columns = [
    ...attributes.map(([key, { name, unit }]) => [withUnit(name, unit && `[${unit}]`), run.value.of("value", key)]),
    ...run.value.keys("signal").map((name) => [name, run.value.of("signal", name)]),
  ];
  const [from, until] = span.value;
  const times = [...new Set(columns.flatMap(([, { times: all }]) => all.filter((t) => t >= from && t <= until)))].sort((a, b) => a - b);
  const quoted = (name) => `"${name.replaceAll('"', '""')}"`;
  const rows = times.map((t) => [t, ...columns.map(([, track]) => track.at(t) ?? "")].join(","));
  return [["time [s]", ...columns.map(([name]) => name)].map(quoted).join(","), ...rows, ""].join("\n");
}

function download(text) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  link.download = `${run.value.header.title || "run"}.csv`;
  link.click();
  URL.revokeObjectURL(link.href);
}

export function Timelines() {
  const [axis, body, grip] = [useRef(null), useRef(null), useRef(null)];
  const marked = useSignal(null); // what is dragged over, [from, until]
  useEffect(() => reveal(body.current, body.current.querySelector(".in-chain")), [chosen.value]);
  revision.value;
  const attributes = elements.value.filter(([key, one]) => one.kind === "attribute" && run.value.of("value", key).times.length);
  const timeAt = ({ clientX }) => {
    const { left, width } = axis.current.getBoundingClientRect();
    const along = (clientX - left) / width;
    return along >= 0 && along <= 1 ? span.value[0] + along * (span.value[1] - span.value[0]) : null;
  };
  const onPointerDown = (event) => (grip.current = event.target.closest("button") ? null : timeAt(event));
  const onPointerMove = (event) => {
    const t = timeAt(event);
    hovered.value = t;
    if (event.buttons && grip.current !== null && t !== null) marked.value = [grip.current, t].sort((a, b) => a - b);
  };
  const onPointerUp = () => {
    const [from, until] = marked.value ?? [];
    if (until - from > (span.value[1] - span.value[0]) * LEAST) zoomed.value = [from, until];
    else if (grip.current !== null) seek(grip.current);
    grip.current = marked.value = null;
  };
  const aside = (
    <>
      <small>click to go there, drag to zoom</small>
      {zoomed.value && <button onClick={() => (zoomed.value = null)}>All</button>}
      <button title="download what is shown" onClick={() => download(asText(attributes))}>CSV</button>
    </>
  );
  return (
    <Panel id="timelines" title="Over time" aside={aside}>
      <div class="body stack" ref={body} tabIndex={0} role="group" aria-label="time lines" onPointerDown={onPointerDown}
        onPointerMove={onPointerMove} onPointerUp={onPointerUp} onPointerLeave={() => (hovered.value = null)}>
        <Ruler />
        <div class="over" ref={axis}>
          <Lines />
          {marked.value && <i class="marked" style={between(...marked.value)} />}
        </div>
        {attributes.map(([key, one]) => <AttributePlot key={key} of={key} element={one} />)}
        {run.value.keys("signal").map((name) => <SignalPlot key={name} name={name} />)}
        <Lanes />
      </div>
    </Panel>
  );
}
