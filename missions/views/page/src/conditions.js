// Conditions such as "inspect_pipeline unfeasible", "battery_level < 0.25" or "follow pipeline success": when they begin to hold.
import { computed, signal } from "@preact/signals";
import { run } from "./state.js";

const LETTERS = { running: "R", success: "S", failure: "F" };
const SAME = { failed: "failure", recovered: "feasible" };
const STATUSES = ["implicit configuration error", "configuration error", "unfeasible", "feasible", "unsolved", "solved", "failure",
  "failed", "recovered", "violated", "satisfied", "running", "success"];
const COMPARED = { "<": (a, b) => a < b, "<=": (a, b) => a <= b, ">": (a, b) => a > b, ">=": (a, b) => a >= b };
export const breakpoints = signal([]); // texts; of a mission that runs, the server has them

/** The names of elements and of nodes of the tree, as [name, track, key]. */
const named = computed(() => {
  const elements = run.value.last("element").map(([key, { name, kind }]) => [name, kind === "attribute" ? "value" : "status", key]);
  const nodes = run.value.of("tree").last?.nodes ?? [];
  return [...elements, ...nodes.map(([uid, , , name]) => [name, "node", uid])];
});

/** What a condition says: the tracks that it is about and when a value fits; null if it says nothing. */
function read(text) {
  const [, subject, sign, number] = text.trim().match(/^(.+?)\s*(<=|>=|<|>)\s*(\S+)$/) ?? [];
  const status = STATUSES.find((one) => text.trim().endsWith(` ${one}`));
  const name = (subject ?? text.trim().slice(0, -(status?.length ?? 0))).trim().replace(/ (is|has)$/, "").replaceAll(/^["']|["']$/g, "");
  const tracks = named.value.filter(([one, track]) => one === name && (track === "value") === Boolean(sign));
  if (!tracks.length || (!status && !Number.isFinite(Number(number)))) return null;
  const fits = (track, value) => {
    if (sign) return value !== null && COMPARED[sign](value, Number(number));
    return track === "node" ? value?.[0] === LETTERS[status] : value === (SAME[status] ?? status);
  };
  return { tracks, fits };
}

export const isCondition = (text) => read(text) !== null;

/** The first instant after t at which a condition begins to hold; undefined if there is none. */
export function nextTime(text, t) {
  const { tracks, fits } = read(text) ?? { tracks: [] };
  const begins = tracks.flatMap(([, track, key]) => {
    const { times, values } = run.value.of(track, key);
    return times.filter((at, index) => at > t && fits(track, values[index]) && !fits(track, values[index - 1] ?? null));
  });
  return begins.length ? Math.min(...begins) : undefined;
}

/** The first breakpoint that is met after one instant and up to another; undefined if none is. */
export function stopBetween(from, until) {
  const times = run.value ? breakpoints.value.map((text) => nextTime(text, from)) : [];
  return times.filter((t) => t <= until).sort((a, b) => a - b)[0];
}

export const suggestions = () => [...new Set(named.value.map(([name, track]) => (track === "value" ? `${name} < ` : `${name} `)))];
