// The scene from above: what the place shows, the way of the robot with what it did where, and where it is at the instant shown.
import { useComputed } from "@preact/signals";
import { useMemo } from "preact/hooks";
import { adaptations, choose, chosen, end, revision, run, time, useAt } from "./state.js";
import { countUntil } from "./track.js";
import { clock, extent, figure } from "./format.js";
import { Panel, stepsBy, useSize } from "./parts.jsx";

const MARGIN = 28; // [px]
const HUES = 6;
const BARS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 5000]; // [m]
const LETTER = 6.4; // width of a letter, about [px]
export const hueOf = (names, name) => `var(--hue-${Math.max(0, names.indexOf(name)) % HUES})`;

/** The names of the actions that were done, in the order of the first time. */
export const actionNames = () => [...new Set(run.value.last("action").map(([, { action }]) => run.value.name(action)))];
const isPlace = (pose) => Number.isFinite(pose?.[0]) && Number.isFinite(pose?.[1]);

/** Metres to pixels, y up, with the same scale in both directions. */
function fitted(points, [width, height]) {
  const [[left, right], [low, high]] = [extent(points.map(([x]) => x)), extent(points.map(([, y]) => y))];
  const scale = Math.min((width - 2 * MARGIN) / Math.max(right - left, 1), (height - 2 * MARGIN) / Math.max(high - low, 1));
  const place = ([x, y]) => [width / 2 + (x - (left + right) / 2) * scale, height / 2 - (y - (low + high) / 2) * scale];
  return { scale, place };
}

/** Names beside their places, but for those that would cover another one. */
function placed(labels, [width, height]) {
  const [taken, gap] = [[], 7];
  return labels.flatMap(({ text, at: [x, y] }) => {
    const wide = text.length * LETTER;
    const spots = [[x + gap, y + 4], [x - gap - wide, y + 4], [x - wide / 2, y - gap - 3], [x - wide / 2, y + gap + 11]];
    const isInside = ([left, base]) => left > 2 && left + wide < width - 2 && base > 12 && base < height - 2;
    const isFree = ([left, base]) => taken.every((one) => left > one.right || left + wide < one.left || Math.abs(base - one.base) > 11);
    const free = spots.find((spot) => isInside(spot) && isFree(spot));
    if (!free) return [];
    taken.push({ left: free[0], right: free[0] + wide, base: free[1] });
    return [{ text, x: free[0], y: free[1] }];
  });
}

/** The way as legs of one action each: {name, times, line}. */
function legsOf(one, place) {
  const poses = one.of("pose");
  const known = poses.values.map((pose, index) => [poses.times[index], pose]).filter(([, pose]) => isPlace(pose));
  const times = known.map(([t]) => t);
  const spans = one.last("action").map(([, { action, start, end: until }]) => [start, until ?? Infinity, one.name(action)]);
  const edges = [...new Set([-Infinity, ...spans.flatMap(([from, until]) => [from, until]), Infinity])].sort((a, b) => a - b);
  return edges.slice(1).flatMap((until, index) => {
    const from = edges[index];
    const part = known.slice(Math.max(0, countUntil(times, from) - 1), countUntil(times, until));
    const name = spans.find(([begin, over]) => begin <= from && over >= until)?.[2] ?? "";
    const line = part.map(([, pose]) => place(pose).map((one) => one.toFixed(1)));
    return part.length > 1 ? [{ name, times: part.map(([t]) => t), line }] : [];
  });
}

/** A leg, as far as it is driven at the instant shown. */
function Leg({ leg: { times, line }, hue }) {
  const driven = useComputed(() => countUntil(times, time.value)).value;
  return (
    <g stroke={hue}>
      <polyline points={line.join(" ")} class="way" />
      <polyline points={line.slice(0, driven).join(" ")} class="way driven" />
    </g>
  );
}

/** Where the robot was at t, if that is known. */
function placeAt(one, place, t) {
  const pose = one.of("pose").at(t) ?? one.of("pose").values[0];
  return isPlace(pose) ? place(pose) : null;
}

function Robot({ place }) {
  const spot = placeAt(run.value, place, time.value);
  return spot && <g class="robot" transform={`translate(${spot})`}><circle r="7" /><circle r="2" class="core" /></g>;
}

function Thing({ name, shape, spots }) {
  if (shape === "line") return <polyline class="thing" points={spots.join(" ")}><title>{name}</title></polyline>;
  return spots.map(([x, y]) => <rect key={x} class="thing spot" x={x - 4} y={y - 4} width="8" height="8"><title>{name}</title></rect>);
}

/** Where the adaptations were decided; those of the same place stand beside one another. */
function Decided({ place }) {
  const taken = [];
  const spread = ([x, y]) => {
    const around = Array.from({ length: 24 }, (_, turn) => [11 * Math.ceil(turn / 8), turn * 0.8]);
    const spots = around.map(([far, angle]) => [x + far * Math.cos(angle), y + far * Math.sin(angle)]);
    const spot = spots.find(([left, top]) => taken.every(([x2, y2]) => Math.hypot(left - x2, top - y2) > 10)) ?? [x, y];
    taken.push(spot);
    return spot;
  };
  return adaptations.value.map(([id, one]) => {
    const spot = placeAt(run.value, place, one.t);
    const [x, y] = spot ? spread(spot) : [];
    return spot && (
      <circle key={id} class={`decided ${chosen.value === id ? "is-chosen" : ""}`} cx={x} cy={y} r="5" onClick={() => choose(id)}>
        <title>{`${clock(one.t)}: ${one.cause}`}</title>
      </circle>
    );
  });
}

function Above({ size }) {
  const things = useAt("scene", 0) ?? run.value.of("scene").last ?? [];
  const known = revision.value;
  const names = actionNames();
  const drawn = useMemo(() => {
    const way = run.value.of("pose").values.filter(isPlace);
    const points = [...way, ...things.flatMap((thing) => thing.points)];
    if (!points.length) return null;
    const { scale, place } = fitted(points, size);
    const bar = BARS.findLast((metres) => metres * scale < size[0] / 4) ?? BARS[0];
    const seen = things.map((thing) => ({ ...thing, spots: thing.points.map(place) }));
    const labels = placed(seen.map(({ name, spots }) => ({ text: name, at: spots[spots.length >> 1] })), size);
    return { place, seen, labels, legs: legsOf(run.value, place), bar, wide: bar * scale };
  }, [size, things, known]);
  if (!drawn) return <p class="body muted">Where the robot is, is not known.</p>;
  const { place, seen, labels, legs, bar, wide } = drawn;
  return (
    <svg width={size[0]} height={size[1]} role="img" aria-label="the scene from above">
      {seen.map((thing) => <Thing key={thing.name} {...thing} />)}
      {legs.map((leg) => <Leg key={leg.times[0]} leg={leg} hue={hueOf(names, leg.name)} />)}
      {labels.map(({ text, x, y }) => <text key={text} x={x} y={y} class="label">{text}</text>)}
      <Decided place={place} />
      <Robot place={place} />
      <Steps place={place} />
      <text class="label" x={size[0] - 6} y={size[1] - 6} text-anchor="end">east x [m] →</text>
      <text class="label" x={6} y={14}>↑ north y [m]</text>
      <g class="bar" transform={`translate(${MARGIN / 2} ${size[1] - 12})`}>
        <path d={`M0 -4 V0 H${wide} V-4`} /><text x={wide + 5} y="2">{figure(bar)} m</text>
      </g>
    </svg>
  );
}

/** The steps of the chosen chain where the robot was at each. */
function Steps({ place }) {
  return stepsBy(({ t }) => placeAt(run.value, place, t)?.map(Math.round).join(" ") ?? null).map(([where, , words]) => (
    <g key={where} class="steps" transform={`translate(${where})`}>
      <rect x={-words.length * 4 - 4} y="-29" width={words.length * 8 + 8} height="15" rx="7" />
      <text text-anchor="middle" y="-17">{words}</text>
    </g>
  ));
}

export function Scene() {
  const [frame, size] = useSize();
  const names = actionNames();
  const pose = useAt("pose", 0);
  return (
    <Panel id="scene" title="Scene" aside={isPlace(pose) && <small>{pose.map((one) => (one ?? 0).toFixed(1)).join(", ")} m</small>}>
      <div class="map" ref={frame}>{size.value[0] > 0 && <Above size={size.value} />}</div>
      <ul class="legend">{names.map((name) => <li key={name}><i style={{ background: hueOf(names, name) }} /> {name}</li>)}</ul>
    </Panel>
  );
}
