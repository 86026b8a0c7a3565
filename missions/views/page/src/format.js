// Numbers and times as people read them.

/** A number in few digits, but never on the wrong side of a limit: 0.2499999 is not 0.25 beside ">= 0.25". */
export function figure(value, limits = []) {
  if (typeof value !== "number") return "–";
  const rounded = (digits) => Number(value.toPrecision(digits));
  const isTrue = (digits) => limits.every((limit) => Math.sign(rounded(digits) - limit) === Math.sign(value - limit));
  const least = Math.max(4, Math.ceil(Math.log10(Math.abs(value) + 1)));
  const digits = [least, least + 1, least + 2].find(isTrue);
  if (digits) return signed(rounded(digits));
  return `just ${rounded(least) > value ? "below" : "above"} ${signed(rounded(least))}`;
}

/** The least and the most of some numbers, however many. */
export const extent = (all) => all.reduce(([low, high], one) => [Math.min(low, one), Math.max(high, one)], [Infinity, -Infinity]);

const signed = (value) => String(value).replace("-", "−");
const SIGNS = { ">=": "≥", "<=": "≤", "->": "→" };
export const pretty = (text) => text.replace(/>=|<=|->/g, (sign) => SIGNS[sign]);
/** An instant: seconds, or the time of day where the robot's clock counts from 1970. */
export const clock = (t) => (t > 1e8 ? `${new Date(t * 1000).toISOString().slice(11, 21)} UTC` : `${t.toFixed(1)} s`);
export const withUnit = (text, unit) => (unit ? `${text} ${unit}` : text);
