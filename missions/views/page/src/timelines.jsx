// Everything over time on one axis: what was measured, done, chosen, planned; the line of the instant; the chosen chain.
import { useRef } from "preact/hooks";
import { actionNames, hueOf } from "./scene.jsx";
import { chain, elements, end, revision, run, runs, seek, start, time } from "./state.js";
import { seconds } from "./format.js";
import { Panel } from "./parts.jsx";
import { AttributePlot, SignalPlot } from "./plots.jsx";

const SAME = 0.012; // part of the axis on which two marks are one

const part = (t) => (t - start.value) / (end.value - start.value);
const percent = (t) => `${(100 * part(t)).toFixed(3)}%`;

const spansOf = (one, track, key) => one.of(track, key).spans(one.end).filter(([, , value]) => value);

/** The bars of what was chosen for a function or component: {from, until, text}. */
const choices = (one, key) => {
  const element = one.element(key);
  return (element.designs ?? element.configurations ?? []).flatMap((each) => spansOf(one, "selected", each).map(([from, until]) => ({ from, until, text: one.name(each) })));
};

/** The lanes of one run: {title, bars} by what they are about. */
function lanesOf(one, names) {
  const known = one.last("element").map(([key]) => [key, one.element(key)]);
  const of = (kind) => known.filter(([, element]) => element.kind === kind);
  const actions = one.last("action").map(([, { action, start: from, end: until, result }]) => ({ from, until: until ?? one.end, text: one.name(action), hue: hueOf(names, one.name(action)), words: result ?? "" }));
  const plans = one.last("plan").map(([, plan]) => ({ from: plan.start, until: plan.end ?? one.end, text: "", words: `${plan.words}: ${plan.result ?? "under way"}` }));
  const calls = one.last("taskplan").map(([, call]) => ({ from: call.asked, until: call.asked, text: call.solved ? "" : "!", words: `${call.outcome} (${call.engine}): ${call.steps.join(", ") || call.message || call.reason}` }));
  const truly = one.last("disturbance").map(([, { t, words }]) => ({ from: t, until: t, text: "", words, hue: "var(--bad)" }));
  return [
    { title: "disturbances", bars: truly },
    { title: "actions", bars: actions },
    ...of("function").map(([key, { name }]) => ({ title: name, bars: choices(one, key) })),
    ...of("component").map(([key, { name }]) => ({ title: name, bars: choices(one, key) })),
    ...of("component").filter(([key]) => one.of("active", key).times.length > 1).map(([key, { name }]) => ({ title: `${name} runs`, bars: spansOf(one, "active", key).map(([from, until]) => ({ from, until, text: "" })) })),
    { title: "reconfiguration plans", bars: plans },
    { title: "planner calls", bars: calls },
  ];
}

/** The lanes with anything in them, each with the bars of every run. */
function lanes() {
  const names = actionNames(runs.value);
  const all = runs.value.map((one) => new Map(lanesOf(one, names).map(({ title, bars }) => [title, bars])));
  const titles = [...new Set(all.flatMap((one) => [...one.keys()]))];
  return titles.map((title) => ({ title, sides: all.map((one) => one.get(title) ?? []) })).filter(({ sides }) => sides.some((bars) => bars.length));
}

function Lane({ title, sides }) {
  return (
    <div class="lane">
      <span class="name">{title}</span>
      <div class="axis">
        {sides.map((bars, side) => (
          <ol key={side} aria-label={sides.length > 1 ? `${title}, run ${side + 1}` : title}>
            {bars.map(({ from, until, text, hue, words = "" }) => (
              <li key={`${from}${text}`} class={from === until ? "mark-at" : ""} style={{ left: percent(from), width: percent(start.value + until - from), background: hue }} title={`${seconds(from)} – ${seconds(until)} ${text} ${words}`}>
                {text || <span class="unseen">{words || "on"}</span>}
              </li>
            ))}
          </ol>
        ))}
      </div>
    </div>
  );
}

/** The line of the instant, and those of the chosen chain, over all that has the axis. */
function Lines() {
  const marks = [];
  chain.value.forEach(({ t }, index) => {
    const near = marks.find((one) => Math.abs(one.at - part(t)) < SAME);
    if (near) near.steps.push(index + 1);
    else marks.push({ at: part(t), steps: [index + 1] });
  });
  return (
    <div class="lines" aria-hidden="true">
      {marks.map(({ at, steps }) => (
        <i key={at} class="step-line" style={{ left: `${100 * at}%` }}>
          <b>{steps.length > 1 ? `${steps[0]}–${steps.at(-1)}` : steps[0]}</b>
        </i>
      ))}
      <i class="instant-line" style={{ left: percent(time.value) }} />
    </div>
  );
}

export function Timelines() {
  const axis = useRef(null);
  const known = revision.value;
  const attributes = elements.value.filter(([key, one]) => one.kind === "attribute" && run.value.of("value", key).times.length);
  const go = (event) => {
    if (event.type === "pointermove" && !event.buttons) return;
    const { left, width } = axis.current.getBoundingClientRect();
    const place = (event.clientX - left) / width;
    if (place >= 0 && place <= 1 && !event.target.closest("button")) seek(start.value + place * (end.value - start.value));
  };
  return (
    <Panel id="timelines" title="Over time" aside={<small>press to go there</small>}>
      <div class="body stack" tabIndex={-1} onPointerDown={go} onPointerMove={go}>
        <div class="over" ref={axis}><Lines /></div>
        {attributes.map(([key, one]) => <AttributePlot key={key} of={key} element={one} />)}
        {run.value.keys("signal").map((name) => <SignalPlot key={name} name={name} />)}
        {lanes(known).map(({ title, sides }) => <Lane key={title} title={title} sides={sides} />)}
      </div>
    </Panel>
  );
}
