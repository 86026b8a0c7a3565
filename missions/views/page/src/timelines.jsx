// Everything over time on one axis: what was measured, done, chosen, planned; the line of the instant; the chosen chain.
import { useEffect, useMemo, useRef } from "preact/hooks";
import { clock } from "./format.js";
import { Panel, reveal, stepsBy } from "./parts.jsx";
import { AttributePlot, SignalPlot } from "./plots.jsx";
import { actionNames, hueOf } from "./scene.jsx";
import { chosen, elements, end, part, percent, revision, run, runs, seek, start, time } from "./state.js";

const SAME = 0.05; // part of the axis on which the marks of a chain are one

/** A bar {from, until [s], text, words, hue}; one that is still open goes to the end of its run. */
const bar = (one, from, until, text = "", words = "", hue = undefined) =>
  ({ from: Math.max(from, one.start), until: until ?? one.end, text, words, hue });

/** The bars of one run as [title, bars], what they are about in the order in which it is drawn. */
function barsOf(one, names) {
  const last = (track) => one.last(track).map(([, value]) => value);
  const known = one.last("element").map(([key]) => [key, one.element(key)]);
  const held = (track, key, text) =>
    one.of(track, key).spans(one.end).filter(([, , value]) => value).map(([from, until]) => bar(one, from, until, text));
  const chosenFor = ([, { name, designs, configurations }]) =>
    [name, (designs ?? configurations ?? []).flatMap((each) => held("selected", each, one.name(each)))];
  const done = last("action").map(({ action, start: from, end: until, result }) =>
    bar(one, from, until, one.name(action), result ?? "", hueOf(names, one.name(action))));
  const isParallel = done.some(({ from }, index) => from < done[index - 1]?.until);
  const switched = known.filter(([key]) => one.of("active", key).times.length > 1);
  return [
    ["disturbances", last("disturbance").map(({ t, words }) => bar(one, t, t, "", words, "var(--bad)"))],
    ...(isParallel ? Object.entries(Object.groupBy(done, ({ text }) => `action ${text}`)) : [["actions", done]]),
    ...known.filter(([, { kind }]) => kind === "function" || kind === "component").map(chosenFor),
    ...switched.map(([key, { name }]) => [`${name} runs`, held("active", key, "")]),
    ["reconfiguration plans", last("plan").map(({ words, start: from, end: until, result }) =>
      bar(one, from, until, "", `${words}: ${result ?? "under way"}`))],
    ["planner calls", last("taskplan").map(({ asked, solved, outcome, engine, steps, message, reason }) =>
      bar(one, asked, asked, "", `${outcome} (${engine}): ${steps.join(", ") || message || reason}`, solved ? undefined : "var(--bad)"))],
  ];
}

/** The lanes with anything in them as [title, the bars of each run]. */
function lanes() {
  const all = runs.value.map((one) => new Map(barsOf(one, actionNames(runs.value))));
  const titles = [...new Set(all.flatMap((one) => [...one.keys()]))];
  return titles.map((title) => [title, all.map((one) => one.get(title) ?? [])]).filter(([, sides]) => sides.some(({ length }) => length));
}

const Bar = ({ from, until, text, words, hue }) => (
  <li class={from === until ? "point" : ""} style={{ left: percent(from), width: percent(start.value + until - from), background: hue }}
    title={`${clock(from)} – ${clock(until)} ${text} ${words}`}>
    {text || <span class="unseen">{words || "on"}</span>}
  </li>
);

const Lane = ({ title, sides }) => (
  <div class="lane">
    <span class="name">{title}</span>
    {sides.map((bars, side) => (
      <ol key={side} aria-label={sides.length > 1 ? `${title}, run ${"AB"[side]}` : title}>
        {bars.map((one, index) => <Bar key={index} {...one} />)}
      </ol>
    ))}
  </div>
);

/** The lanes are drawn anew when there is more to draw, not at each instant. */
function Lanes() {
  const known = revision.value;
  return useMemo(() => lanes().map(([title, sides]) => <Lane key={title} title={title} sides={sides} />), [known, runs.value]);
}

/** The line of the instant, and those of the chosen chain, over all that has the axis. */
function Lines() {
  let last = -1;
  const near = ({ t }) => (last = part(t) - last > SAME ? part(t) : last);
  return (
    <div class="lines" aria-hidden="true">
      {stepsBy(near).map(([place, { t }, words]) => <i key={place} class="step-line" style={{ left: percent(t) }}><b>{words}</b></i>)}
      <i class="instant-line" style={{ left: percent(time.value) }} />
    </div>
  );
}

export function Timelines() {
  const [axis, body] = [useRef(null), useRef(null)];
  useEffect(() => reveal(body.current, body.current.querySelector(".in-chain")), [chosen.value]);
  revision.value;
  const attributes = elements.value.filter(([key, one]) => one.kind === "attribute" && run.value.of("value", key).times.length);
  const go = (event) => {
    const { left, width } = axis.current.getBoundingClientRect();
    const place = (event.clientX - left) / width;
    if (event.buttons && place >= 0 && place <= 1 && !event.target.closest("button")) seek(start.value + place * (end.value - start.value));
  };
  return (
    <Panel id="timelines" title="Over time" aside={<small>{runs.value.length > 1 ? "the other run dashed" : "press to go there"}</small>}>
      <div class="body stack" ref={body} tabIndex={0} role="group" aria-label="time lines" onPointerDown={go} onPointerMove={go}>
        <div class="over" ref={axis}><Lines /></div>
        {attributes.map(([key, one]) => <AttributePlot key={key} of={key} element={one} />)}
        {run.value.keys("signal").map((name) => <SignalPlot key={name} name={name} />)}
        <Lanes />
      </div>
    </Panel>
  );
}
