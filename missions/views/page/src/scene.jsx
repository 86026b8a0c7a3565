// The scene from above: what the place shows, the way of the robot with what it did where, and where it is at the instant shown.
import { useComputed } from "@preact/signals";
import { useMemo } from "preact/hooks";
import { adaptations, at, chain, choose, chosen, end, revision, run, runs, shown, time, useAt } from "./state.js";
import { countUntil } from "./track.js";
import { figure, seconds } from "./format.js";
import { Panel, useSize } from "./parts.jsx";

const MARGIN = 28; // [px]
const HUES = 6;
const BARS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 5000]; // [m]
const LETTER = 6.4; // width of a letter, about [px]

export const hueOf = (names, name) => `var(--hue-${Math.max(0, names.indexOf(name)) % HUES})`;

/** The names of the actions that were done in any run, in the order of the first time. */
export const actionNames = (all) => [...new Set(all.flatMap((one) => one.last("action").map(([, { action }]) => one.name(action))))];

const isPlace = ([x, y]) => Number.isFinite(x) && Number.isFinite(y);

/** Metres to pixels, y up, with the same scale in both directions. */
function fitted(points, [width, height]) {
  const [xs, ys] = [points.map(([x]) => x), points.map(([, y]) => y)];
  const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  const scale = Math.min((width - 2 * MARGIN) / Math.max(right - left, 1), (height - 2 * MARGIN) / Math.max(high - low, 1));
  const [middle, centre] = [(left + right) / 2, (low + high) / 2];
  const place = ([x, y]) => [width / 2 + (x - middle) * scale, height / 2 - (y - centre) * scale];
  return { scale, place };
}

/** Names beside their places, but for those that would cover another one. */
function placed(labels, [width, height]) {
  const taken = [];
  return labels.flatMap(({ text, at: [x, y], gap = 7 }) => {
    const wide = text.length * LETTER;
    const spots = [[x + gap, y + 4], [x - gap - wide, y + 4], [x - wide / 2, y - gap - 3], [x - wide / 2, y + gap + 11]];
    const free = spots.find(([left, base]) =>
      left > 2 && left + wide < width - 2 && base > 12 && base < height - 2 && taken.every((one) => left > one.right || left + wide < one.left || base - 11 > one.base || base < one.base - 11));
    if (!free) return [];
    taken.push({ left: free[0], right: free[0] + wide, base: free[1] });
    return [{ text, x: free[0], y: free[1] }];
  });
}

/** The way as legs of one action each: {name, from, until, times, points, line}. */
function legsOf(one, place) {
  const poses = one.of("pose");
  const sane = poses.values.map((pose, index) => [poses.times[index], pose]).filter(([, pose]) => pose && isPlace(pose));
  const times = sane.map(([t]) => t);
  const spans = one.last("action").map(([, { action, start, end: until }]) => [start, until ?? Infinity, one.name(action)]);
  const edges = [...new Set([-Infinity, ...spans.flatMap(([from, until]) => [from, until]), Infinity])].sort((a, b) => a - b);
  return edges.slice(1).flatMap((until, index) => {
    const from = edges[index];
    const part = sane.slice(Math.max(0, countUntil(times, from) - 1), countUntil(times, until));
    if (part.length < 2) return [];
    const points = part.map(([, pose]) => place(pose));
    const name = spans.find(([begin, over]) => begin <= from && over >= until)?.[2] ?? "";
    return [{ name, times: part.map(([t]) => t), line: points.map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`) }];
  });
}

/** A leg, as far as it is driven at the instant shown. */
function Leg({ leg, hue }) {
  const driven = useComputed(() => countUntil(leg.times, time.value)).value;
  return (
    <>
      <polyline points={leg.line.join(" ")} class="way" stroke={hue} />
      <polyline points={leg.line.slice(0, driven).join(" ")} class="way driven" stroke={hue} />
    </>
  );
}

function Robot({ one, place, other }) {
  const pose = useComputed(() => (revision.value, one.of("pose").at(time.value))).value;
  if (!pose || !isPlace(pose)) return null;
  const [x, y] = place(pose);
  return (
    <g class={`robot ${other ? "other" : ""}`} transform={`translate(${x} ${y})`}>
      <circle r="7" />
      <circle r="2" class="core" />
    </g>
  );
}

/** Where the robot was at t, if that is known. */
const placeAt = (one, place, t) => {
  const pose = one.of("pose").at(t) ?? one.of("pose").values[0];
  return pose && isPlace(pose) ? place(pose) : null;
};

function Map_({ size }) {
  const things = useAt("scene", 0) ?? run.value.of("scene").last ?? [];
  const known = revision.value;
  const names = actionNames(runs.value);
  const drawn = useMemo(() => {
    const ways = runs.value.flatMap((one) => one.of("pose").values.filter((pose) => pose && isPlace(pose)));
    const points = [...ways, ...things.flatMap((thing) => thing.points)];
    if (!points.length) return null;
    const fit = fitted(points, size);
    const bar = BARS.findLast((metres) => metres * fit.scale < size[0] / 4) ?? BARS[0];
    const labels = things.map((thing) => ({ text: thing.name, at: fit.place(thing.points[thing.points.length >> 1]) }));
    return { ...fit, bar, legs: runs.value.map((one) => legsOf(one, fit.place)), labels: placed(labels, size) };
  }, [size, things, known]);
  if (!drawn) return <p class="body muted">Where the robot is, is not known.</p>;
  const { place, legs, labels, scale, bar } = drawn;
  const [width, height] = size;
  return (
    <svg width={width} height={height} role="img" aria-label={`the scene from above at ${seconds(time.value)}`}>
      {things.map((thing) => {
        const spots = thing.points.map(place);
        return thing.shape === "line" && spots.length > 1
          ? <polyline key={thing.name} class="thing" points={spots.join(" ")}><title>{thing.name}</title></polyline>
          : spots.map(([x, y]) => <rect key={thing.name} class="thing spot" x={x - 4} y={y - 4} width="8" height="8"><title>{thing.name}</title></rect>);
      })}
      {legs.flatMap((list, side) => list.map((leg, index) => <g key={`${side}.${index}`} class={side === shown.value ? "" : "other"}><Leg leg={leg} hue={hueOf(names, leg.name)} /></g>))}
      {labels.map(({ text, x, y }) => <text key={text} x={x} y={y} class="label">{text}</text>)}
      {adaptations.value.map(([key, one]) => {
        const spot = placeAt(run.value, place, one.t);
        return spot && <circle key={key} class={`decided ${chosen.value === key ? "is-chosen" : ""}`} cx={spot[0]} cy={spot[1]} r="5" onClick={() => choose(key)}><title>{`${seconds(one.t)}: ${one.cause}`}</title></circle>;
      })}
      {runs.value.map((one, side) => <Robot key={side} one={one} place={place} other={side !== shown.value} />)}
      <Steps place={place} />
      <g class="bar" transform={`translate(${MARGIN / 2} ${height - 12})`}>
        <path d={`M0 -4 V0 H${bar * scale} V-4`} />
        <text x={bar * scale + 5} y="2">{figure(bar)} m</text>
      </g>
    </svg>
  );
}

/** The steps of the chosen chain where the robot was at each; those at one place share their mark. */
function Steps({ place }) {
  const spots = new Map();
  chain.value.forEach((step, index) => {
    const spot = placeAt(run.value, place, step.t);
    if (spot) spots.set(spot.map(Math.round).join(), [...(spots.get(spot.map(Math.round).join()) ?? []), index + 1]);
  });
  return [...spots].map(([where, steps]) => {
    const [x, y] = where.split(",").map(Number);
    const words = steps.length > 2 ? `${steps[0]}–${steps.at(-1)}` : steps.join(" ");
    return (
      <g key={where} class="steps" transform={`translate(${x} ${y - 20})`}>
        <rect x={-words.length * 4 - 4} y="-9" width={words.length * 8 + 8} height="15" rx="7" />
        <text text-anchor="middle" y="3">{words}</text>
      </g>
    );
  });
}

export function Scene() {
  const [frame, size] = useSize();
  const names = actionNames(runs.value);
  const pose = useAt("pose", 0);
  return (
    <Panel id="scene" title="Scene" aside={pose && isPlace(pose) && <small>{pose.map((one) => (one ?? 0).toFixed(1)).join(", ")} m</small>}>
      <div class="map" ref={frame}>{size.value[0] > 0 && <Map_ size={size.value} />}</div>
      <ul class="legend">
        {names.map((name) => <li key={name}><i style={{ background: hueOf(names, name) }} /> {name}</li>)}
      </ul>
    </Panel>
  );
}
