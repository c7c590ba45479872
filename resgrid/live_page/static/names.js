// Text for names and values of axes: Greek letters with subscripts, angles as fractions of pi.

/** @typedef {import("./model.js").Axis} Axis */

/** @type {Record<string, string>} */
const GREEK = { alpha: "α", beta: "β", gamma: "γ", theta: "θ", phi: "φ", psi: "ψ", omega: "ω" };
const MOST_PARTS = 12;

/** Return the name of an axis as text: θ₁ for theta_1. @param {Axis} axis */
export function nameOf({ name }) {
  const [, letter, index = ""] = /^([a-z]+?)(?:_?(\d+))?$/.exec(name) ?? [];
  if (!letter || !(letter in GREEK)) return name;
  return GREEK[letter] + [...index].map((digit) => String.fromCharCode(0x2080 + Number(digit))).join("");
}

/** Return a tick label: an angle as a simple fraction of pi, or a number. @param {number} value @param {Axis} axis */
export function tickOf(value, { unit }) {
  const plain = String(Number(value.toPrecision(4)));
  if (unit !== "rad" || value === 0) return plain;
  for (let parts = 1; parts <= MOST_PARTS; parts++) {
    const multiple = (value * parts) / Math.PI, whole = Math.round(multiple);
    if (whole === 0 || Math.abs(multiple - whole) > 1e-6) continue;
    const factor = Math.abs(whole) === 1 ? "" : String(Math.abs(whole));
    return `${whole < 0 ? "−" : ""}${factor}π${parts > 1 ? `/${parts}` : ""}`;
  }
  return plain;
}

/** Return a coordinate with its unit; angles in degrees. @param {number} value @param {Axis} axis */
function coordinateOf(value, { unit }) {
  const text = unit === "rad" ? `${((180 * value) / Math.PI).toFixed(1)}°` : `${Number(value.toPrecision(5))}${unit && unit !== "cell" ? ` ${unit}` : ""}`;
  return text.replace("-", "−");
}

/** Return a point as text. @param {number[]} point @param {{axes: Axis[]}} scene */
export const placeOf = (point, { axes }) => point.map((value, a) => `${nameOf(axes[a])} ${coordinateOf(value, axes[a])}`).join(", ");
