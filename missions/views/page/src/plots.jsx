// A measurement over time, with its thresholds, where it was stale.
import { effect, signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import uPlot from "uplot";
import { end, revision, run, span, stepsOf, useAt } from "./state.js";
import { clock, figure, pretty, withUnit } from "./format.js";
import { Name, Standing } from "./parts.jsx";
import { colour, theme } from "./theme.js";

const HEIGHT = 84; // [px]
const AXIS = 44; // room for the numbers at the left [px]
const NAMED = 3; // names of a group of thresholds; the rest is counted
export const hovered = signal(null); // the time where the pointer is
const FAR = "1500px 0px"; // a plot farther out of sight than this is not made yet

/** A track as columns that uPlot takes; the last value holds to the end. */
const columns = ({ times, values }) => [[...times, end.value], [...values, values.at(-1) ?? null]];

function shade(plot, spans) {
  const { ctx, bbox } = plot;
  ctx.fillStyle = colour("--line");
  for (const [from, until, isStale] of spans) {
    if (!isStale) continue;
    const [left, right] = [from, until].map((t) => plot.valToPos(t, "x", true));
    for (let x = left; x < right; x += 6) ctx.fillRect(x, bbox.top, Math.min(2, right - x), bbox.height);
  }
}

function rule(plot, limits) {
  const { ctx, bbox } = plot;
  ctx.strokeStyle = colour("--warn");
  ctx.lineWidth = devicePixelRatio;
  ctx.setLineDash([5, 4]);
  for (const value of limits) {
    const y = plot.valToPos(value, "y", true);
    ctx.beginPath();
    ctx.moveTo(bbox.left, y);
    ctx.lineTo(bbox.left + bbox.width, y);
    ctx.stroke();
  }
  ctx.setLineDash([]);
}

const STEPPED = uPlot.paths.stepped({ align: 1 });

const LINE = { stroke: () => colour("--ink"), width: 1.5, paths: STEPPED, points: { show: false }, spanGaps: true };

/** From where to where the numbers go: over all that was measured and its thresholds, and a tenth more at each end. */
const spread = (limits) => (_, low, high) => {
  const [least, most] = [Math.min(low ?? 0, ...limits), Math.max(high ?? 1, ...limits)];
  const more = (most - least || 1) / 10;
  return [least - more, most + more];
};

function options(width, limits, stale) {
  const grid = { stroke: () => colour("--line"), width: 1 };
  const numbers = { stroke: () => colour("--muted"), grid, ticks: { show: false }, font: "11px system-ui", size: AXIS, space: 26 };
  return {
    width, height: HEIGHT, legend: { show: false }, cursor: { show: false }, padding: [6, 0, 4, 0],
    scales: { x: { time: false, range: () => span.peek() }, y: { range: spread(limits) } },
    axes: [{ show: false }, { ...numbers, values: (_, ticks) => ticks.map((tick) => figure(tick)) }],
    series: [{}, LINE],
    hooks: { drawClear: [(plot) => shade(plot, stale())], draw: [(plot) => rule(plot, limits)] },
  };
}

/** The canvas; `track` gives the curve, `stale` where it was too old. */
function Canvas({ label, track, stale, limits }) {
  const frame = useRef(null);
  useEffect(() => {
    let plot, stop;
    const draw = () => (theme.value, revision.value, span.value, plot.setData(columns(track())));
    const make = () => {
      plot = new uPlot(options(frame.current.clientWidth, limits, stale), null, frame.current);
      stop = effect(() => void draw());
    };
    const near = new IntersectionObserver(([{ isIntersecting }]) => isIntersecting && !plot && make(), { rootMargin: FAR });
    const watch = new ResizeObserver(() => plot?.setSize({ width: frame.current.clientWidth, height: HEIGHT }));
    near.observe(frame.current);
    watch.observe(frame.current);
    return () => {
      near.disconnect();
      watch.disconnect();
      stop?.();
      plot?.destroy();
    };
  }, []);
  return <div class="plot" ref={frame} role="img" aria-label={label} style={{ height: `${HEIGHT}px` }} />;
}

/** Thresholds that are the same, as one: what they are for, and how long each has to hold. */
function grouped(thresholds) {
  const groups = new Map();
  for (const key of thresholds) {
    const { operator, value, dwell, hysteresis, used_by: on } = run.value.element(key) ?? {};
    if (!operator) continue;
    const id = [operator, value, dwell, hysteresis].join(" ");
    const group = groups.get(id) ?? { id, operator, value, dwell, hysteresis, keys: [], on: [] };
    group.keys.push(key);
    group.on.push(...on);
    groups.set(id, group);
  }
  return [...groups.values()].sort((a, b) => b.value - a.value);
}

function Threshold({ operator, value, dwell, hysteresis, keys, on }) {
  const more = [dwell && `dwell ${figure(dwell)} s`, hysteresis && `hysteresis ${figure(hysteresis)}`].filter(Boolean);
  const names = on.map((each) => run.value.name(each));
  const rest = names.length > NAMED ? ` and ${names.length - NAMED} more` : "";
  return (
    <li title={names.join(", ")}>
      <Standing of={keys[0]} quiet /> {pretty(operator)} {figure(value)}{" "}
      <span class="muted">{[names.slice(0, NAMED).join(", ") + rest, ...more].join(" · ")}</span>
    </li>
  );
}

/** What a curve reads where the pointer is. */
function Read({ of, track }) {
  if (hovered.value === null) return null;
  return <small class="reads">{figure(run.value.of(track, of).at(hovered.value))} at {clock(hovered.value)}</small>;
}

export function AttributePlot({ of, element: { name, unit, max_age, constraints } }) {
  const limits = constraints.map((one) => run.value.element(one)?.value).filter(Number.isFinite);
  const words = withUnit(figure(useAt("value", of), limits), unit);
  const isStale = useAt("stale", of);
  const track = () => run.value.of("value", of);
  const stale = () => run.peek().of("stale", of).spans(end.peek());
  return (
    <div class={`measured ${stepsOf([of]).length ? "in-chain" : ""}`}>
      <p>
        <Name of={of} /> <b>{words}</b> {isStale ? <span class="tag bad">stale</span> : null}
        {max_age !== null && <small>stale after {figure(max_age)} s</small>}
        <Read of={of} track="value" />
      </p>
      <ul>{grouped(constraints).map((one) => <Threshold key={one.id} {...one} />)}</ul>
      <Canvas label={`${name} over time, ${words} now`} track={track} stale={stale} limits={limits} />
    </div>
  );
}

export function SignalPlot({ name }) {
  const value = figure(useAt("signal", name));
  const track = () => run.value.of("signal", name);
  return (
    <div class="measured">
      <p><span class="name">{name}</span> <b>{value}</b> <Read of={name} track="signal" /></p>
      <Canvas label={`${name} over time, ${value} now`} track={track} stale={() => []} limits={[]} />
    </div>
  );
}
