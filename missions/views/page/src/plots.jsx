// A measurement over time, with its thresholds, where it was stale, and the other run's beside it where there are two.
import { useEffect, useRef } from "preact/hooks";
import uPlot from "uplot";
import { effect } from "@preact/signals";
import { end, revision, run, runs, shown, start, stepsOf, useAt } from "./state.js";
import { figure, pretty, withUnit } from "./format.js";
import { Name, Standing } from "./parts.jsx";
import { colour, theme } from "./theme.js";

const HEIGHT = 84; // [px]
export const AXIS = 44; // room for the numbers at the left [px]
const FAR = "1500px 0px"; // a plot farther out of sight than this is not made yet

/** What a key of a track was in each run, as columns that uPlot takes; the last value holds to the end. */
function columns(tracks) {
  const tables = tracks.map(({ times, values }) => [[...times, end.value], [...values, values.at(-1)].map((one) => one ?? null)]);
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

function options(width, limits, staleSpans, count) {
  const axis = { stroke: () => colour("--muted"), grid: { stroke: () => colour("--line"), width: 1 }, ticks: { show: false }, font: "11px system-ui" };
  const path = uPlot.paths.stepped({ align: 1 });
  const line = (index) => ({
    stroke: () => colour(index === shown.peek() ? "--ink" : "--hue-3"), dash: index === shown.peek() ? [] : [4, 3], width: 1.5, paths: path, points: { show: false }, spanGaps: true,
  });
  return {
    width, height: HEIGHT, legend: { show: false }, cursor: { show: false }, padding: [6, 0, 4, 0],
    scales: {
      x: { time: false, range: () => [start.peek(), end.peek()] },
      y: { range: (_, low, high) => [Math.min(low ?? 0, ...limits), Math.max(high ?? 1, ...limits)].map((one, side, [a, b]) => one + (side - 0.5) * 0.2 * (b - a || 1)) },
    },
    axes: [{ ...axis, show: false }, { ...axis, size: AXIS, space: 26, values: (_, ticks) => ticks.map((tick) => figure(tick)) }],
    series: [{}, ...Array.from({ length: count }, (_, index) => line(index))],
    hooks: { drawClear: [(plot) => shade(plot, staleSpans())], draw: [(plot) => rule(plot, limits)] },
  };
}

/** The canvas; `tracks` gives what is drawn of each run, `stale` where it was too old. */
function Canvas({ label, tracks, stale, limits }) {
  const frame = useRef(null);
  useEffect(() => {
    let plot, stop;
    const make = () => {
      plot = new uPlot(options(frame.current.clientWidth, limits, stale, runs.value.length), columns(tracks()), frame.current);
      stop = effect(() => {
        theme.value;
        shown.value;
        revision.value;
        plot.setData(columns(tracks()));
      });
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

export function AttributePlot({ of, element }) {
  const limits = element.thresholds.map((one) => run.value.element(one)?.value).filter(Number.isFinite);
  const value = useAt("value", of);
  const isStale = useAt("stale", of);
  const tracks = () => runs.value.map((one) => one.of("value", one.find(element)));
  const words = withUnit(figure(value, limits), element.unit);
  return (
    <div class={`measured ${stepsOf("elements", of).length ? "in-chain" : ""}`}>
      <p>
        <Name of={of} /> <b>{words}</b> {isStale ? <span class="tag bad">stale</span> : null}
        {element.max_age !== null && <small>stale after {figure(element.max_age)} s</small>}
      </p>
      {element.thresholds.length > 0 && <ul>{element.thresholds.map((one) => <Threshold key={one} of={one} />)}</ul>}
      <Canvas label={`${element.name} over time, ${words} now`} tracks={tracks} stale={() => run.peek().of("stale", of).spans(end.peek())} limits={limits} />
    </div>
  );
}

export function SignalPlot({ name }) {
  const value = useAt("signal", name);
  const tracks = () => runs.value.map((one) => one.of("signal", name));
  return (
    <div class="measured">
      <p>
        <span class="name">{name}</span> <b>{figure(value)}</b>
      </p>
      <Canvas label={`${name} over time, ${figure(value)} now`} tracks={tracks} stale={() => []} limits={[]} />
    </div>
  );
}
