// What the page shows, as signals: the run, the instant, and what is chosen. Every view is a function of these.
import { batch, computed, signal, useComputed } from "@preact/signals";
import { countUntil } from "./track.js";

export const run = signal(null);
export const revision = signal(0); // counts what was added to the run
export const time = signal(0); // the instant shown [s]
export const isFollowing = signal(false); // whether the instant is that of a mission that still runs
export const chosen = signal(null); // key of the adaptation
export const selected = signal(null); // key of the element
export const start = computed(() => (revision.value, run.value?.start ?? 0));
export const end = computed(() => (revision.value, Math.max(run.value?.end ?? 0, start.value + 0.001)));

/** How far along the axis of time t is: as a part of it, and as a style says it. */
export const part = (t) => (t - start.value) / (end.value - start.value);
export const percent = (t) => `${(100 * part(t)).toFixed(3)}%`;

/** The part of the time that "Over time" shows: [from, until] where it is zoomed, else all of the run. */
export const zoomed = signal(null);
export const span = computed(() => zoomed.value ?? [start.value, end.value]);
export const place = (t) => `${((100 * (t - span.value[0])) / (span.value[1] - span.value[0])).toFixed(3)}%`;

/** Where the panels stand, in order; which one fills the page; which of those that share a place is shown. */
export const PANELS = ["adaptations", "scene", "tree", "side", "timelines", "knowledge"];
export const order = signal(PANELS);
export const enlarged = signal(null);
export const tab = signal("whatif");

/** Let a panel and the next one change places. */
export function swap(id) {
  const [list, here] = [[...order.value], order.value.indexOf(id)];
  const next = (here + 1) % list.length;
  [list[here], list[next]] = [list[next], list[here]];
  order.value = list;
}
export const enlarge = (id) => (enlarged.value = enlarged.value === id ? null : id);

/** What a key of a track is at the instant shown; a view that reads it is drawn anew only when that changes. */
export const at = (track, key) => (revision.value, run.value.of(track, key).at(time.value));
export const useAt = (track, key) => useComputed(() => at(track, key)).value;

/** The first instant at which the rows of a time count; they are told to the millisecond. */
const counted = (t) => Math.ceil(t * 1000 - 1e-6) / 1000;
const timely = (one) => ({ ...one, t: counted(one.t), chain: one.chain.map((step) => ({ ...step, t: counted(step.t) })) });

/** The adaptations in order of time, as [key, adaptation], those still to come among them. */
export const adaptations = computed(() => {
  revision.value;
  if (!run.value) return [];
  return run.value.last("adaptation").map(([key, one]) => [key, timely(one)]).sort(([, a], [, b]) => a.t - b.t);
});
export const adaptation = computed(() => adaptations.value.find(([key]) => key === chosen.value)?.[1]);
export const chain = computed(() => adaptation.value?.chain ?? []);

/** The places in the chosen chain (from 1) of the steps that are about any of some elements. */
export const stepsOf = (elements) =>
  chain.value.flatMap((step, index) => (step.elements.some((one) => elements.includes(one)) ? [index + 1] : []));

/** When there came to be the elements that there are at the instant shown. */
const amendment = computed(() => {
  const { times } = (revision.value, run.value.amended);
  return times[Math.max(countUntil(times, time.value), 1) - 1];
});

/** What there is at the instant shown, as [key, element]. */
export const elements = computed(() => {
  const now = (key) => [key, run.value.of("element", key).at(amendment.value)];
  return run.value.keys("element").map(now).filter(([, one]) => one);
});

export function seek(t) {
  batch(() => ([isFollowing.value, time.value] = [false, Math.min(Math.max(t, start.value), end.value)]));
}

export const follow = () => batch(() => ([isFollowing.value, time.value] = [true, end.value]));

function go(key) {
  batch(() => {
    chosen.value = key;
    seek(adaptation.value.t);
  });
}

/** Choose an adaptation and go to its instant; the one chosen, at its instant, is let go of. */
export function choose(key) {
  if (key === chosen.value && adaptation.value.t === time.value) chosen.value = null;
  else go(key);
}

/** Go to the next (1) or the previous (-1) adaptation. */
export function leap(direction) {
  const list = adaptations.value;
  const here = adaptation.value?.t === time.value ? list.findIndex(([key]) => key === chosen.value) + direction : null;
  const near = direction > 0 ? list.findIndex(([, { t }]) => t > time.value) : list.findLastIndex(([, { t }]) => t < time.value);
  const next = list[here ?? near];
  if (next) go(next[0]);
}

/** Go to the next (1) or the previous (-1) moment at which anything changed. */
export function step(direction) {
  const { times } = run.value.moments;
  const until = countUntil(times, time.value);
  const place = direction > 0 ? until : until - (times[until - 1] === time.value ? 2 : 1);
  seek(times[place] ?? (direction > 0 ? end.value : start.value));
}

export const select = (key) => (selected.value = key === selected.value ? null : key);
