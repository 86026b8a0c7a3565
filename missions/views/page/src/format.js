// Numbers and times as people read them.

/** A number in few digits, but never on the wrong side of a limit: 0.2499999 is not 0.25 beside ">= 0.25". */
export function figure(value, limits = []) {
  if (typeof value !== "number") return "–";
  const rounded = (digits) => Number(value.toPrecision(digits));
  const isTrue = (digits) => limits.every((limit) => Math.sign(rounded(digits) - limit) === Math.sign(value - limit));
  const digits = [4, 5, 6].find(isTrue);
  if (digits) return signed(rounded(digits));
  return `just ${rounded(6) > value ? "below" : "above"} ${signed(rounded(6))}`;
}

/** The least and the most of some numbers, however many. */
export const extent = (all) => all.reduce(([low, high], one) => [Math.min(low, one), Math.max(high, one)], [Infinity, -Infinity]);
const signed = (value) => String(value).replace("-", "−");
const SIGNS = { ">=": "≥", "<=": "≤", "->": "→" };
export const pretty = (text) => text.replace(/>=|<=|->/g, (sign) => SIGNS[sign]);
export const seconds = (t) => `${t.toFixed(1)} s`;
export const withUnit = (text, unit) => (unit ? `${text} ${unit}` : text);
export const plainly = (value) => (typeof value === "number" ? figure(value) : String(value));
