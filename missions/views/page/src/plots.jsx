// A measurement over time, with its thresholds, where it was stale, and the other run's beside it where there are two.
import { effect } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import uPlot from "uplot";
import { end, revision, run, runs, shown, start, stepsOf, useAt } from "./state.js";
import { figure, pretty, withUnit } from "./format.js";
import { Name, Standing } from "./parts.jsx";
import { colour, theme } from "./theme.js";

const HEIGHT = 84; // [px]
const AXIS = 44; // room for the numbers at the left [px]
const FAR = "1500px 0px"; // a plot farther out of sight than this is not made yet

/** What a key of a track was in each run, as columns that uPlot takes; the last value holds to the end. */
function columns(tracks) {
  const tables = tracks.map(({ times, values }) => [[...times, end.value], [...values, values.at(-1) ?? null]]);
  return tables.length > 1 ? uPlot.join(tables) : tables[0];
}

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

/** The line of a run; the one shown is drawn through. */
function line(_, side) {
  const isShown = () => side === shown.peek();
  const stroke = () => colour(isShown() ? "--ink" : "--hue-3");
  return { stroke, dash: isShown() ? [] : [4, 3], width: 1.5, paths: STEPPED, points: { show: false }, spanGaps: true };
}

/** From where to where the numbers go: over all that was measured and its thresholds, and a tenth more at each end. */
const spread = (limits) => (_, low, high) => {
  const [least, most] = [Math.min(low ?? 0, ...limits), Math.max(high ?? 1, ...limits)];
  const more = (most - least || 1) / 10;
  return [least - more, most + more];
};

function options(width, limits, stale, count) {
  const grid = { stroke: () => colour("--line"), width: 1 };
  const numbers = { stroke: () => colour("--muted"), grid, ticks: { show: false }, font: "11px system-ui", size: AXIS, space: 26 };
  return {
    width, height: HEIGHT, legend: { show: false }, cursor: { show: false }, padding: [6, 0, 4, 0],
    scales: { x: { time: false, range: () => [start.peek(), end.peek()] }, y: { range: spread(limits) } },
    axes: [{ show: false }, { ...numbers, values: (_, ticks) => ticks.map((tick) => figure(tick)) }],
    series: [{}, ...Array.from({ length: count }, line)],
    hooks: { drawClear: [(plot) => shade(plot, stale())], draw: [(plot) => rule(plot, limits)] },
  };
}

/** The canvas; `tracks` gives what is drawn of each run, `stale` where it was too old. */
function Canvas({ label, tracks, stale, limits }) {
  const frame = useRef(null);
  useEffect(() => {
    let plot, stop;
    const draw = () => (theme.value, shown.value, revision.value, plot.setData(columns(tracks())));
    const make = () => {
      plot = new uPlot(options(frame.current.clientWidth, limits, stale, runs.value.length), null, frame.current);
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

/** A threshold as the plot's head says it: what it is for, and how long it has to hold. */
function Threshold({ of }) {
  const one = run.value.element(of);
  const more = [one.dwell && `dwell ${figure(one.dwell)} s`, one.hysteresis && `hysteresis ${figure(one.hysteresis)}`].filter(Boolean);
  return (
    <li>
      <Standing of={of} quiet /> {pretty(one.operator)} {figure(one.value)}{" "}
      <span class="muted">{[one.on.map((each) => run.value.name(each)).join(", "), ...more].join(" · ")}</span>
    </li>
  );
}

export function AttributePlot({ of, element: { name, unit, max_age, thresholds, ...element } }) {
  const limits = thresholds.map((one) => run.value.element(one)?.value).filter(Number.isFinite);
  const words = withUnit(figure(useAt("value", of), limits), unit);
  const isStale = useAt("stale", of);
  const tracks = () => runs.value.map((one) => one.of("value", one.find({ name, ...element })));
  const stale = () => run.peek().of("stale", of).spans(end.peek());
  return (
    <div class={`measured ${stepsOf("elements", of).length ? "in-chain" : ""}`}>
      <p>
        <Name of={of} /> <b>{words}</b> {isStale ? <span class="tag bad">stale</span> : null}
        {max_age !== null && <small>stale after {figure(max_age)} s</small>}
      </p>
      <ul>{thresholds.map((one) => <Threshold key={one} of={one} />)}</ul>
      <Canvas label={`${name} over time, ${words} now`} tracks={tracks} stale={stale} limits={limits} />
    </div>
  );
}

export function SignalPlot({ name }) {
  const value = figure(useAt("signal", name));
  const tracks = () => runs.value.map((one) => one.of("signal", name));
  return (
    <div class="measured">
      <p><span class="name">{name}</span> <b>{value}</b></p>
      <Canvas label={`${name} over time, ${value} now`} tracks={tracks} stale={() => []} limits={[]} />
    </div>
  );
}
