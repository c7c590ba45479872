// Names and numbers of axes as they are written in text: Greek letters with subscripts, angles as fractions of pi.

/** @typedef {import("./model.js").Axis} Axis */

/** @type {Record<string, string>} */
const GREEK = { alpha: "α", beta: "β", gamma: "γ", theta: "θ", phi: "φ", psi: "ψ", omega: "ω" };
const MOST_PARTS = 12;

/** The name of an axis: theta_1 is θ₁. @param {Axis} axis */
export function nameOf({ name }) {
  const [, letter, index = ""] = /^([a-z]+?)(?:_?(\d+))?$/.exec(name) ?? [];
  if (!letter || !(letter in GREEK)) return name;
  return GREEK[letter] + [...index].map((digit) => String.fromCharCode(0x2080 + Number(digit))).join("");
}

/** An angle as a fraction of pi where it is a simple one. @param {number} value @param {Axis} axis */
export function tickOf(value, { unit }) {
  const plain = String(Number(value.toPrecision(4)));
  if (unit !== "rad" || value === 0) return plain;
  for (let parts = 1; parts <= MOST_PARTS; parts++) {
    const share = (value * parts) / Math.PI, whole = Math.round(share);
    if (whole === 0 || Math.abs(share - whole) > 1e-6) continue;
    const factor = Math.abs(whole) === 1 ? "" : String(Math.abs(whole));
    return `${whole < 0 ? "−" : ""}${factor}π${parts > 1 ? `/${parts}` : ""}`;
  }
  return plain;
}

/** A coordinate with its unit; angles in degrees. @param {number} value @param {Axis} axis */
function coordinateOf(value, { unit }) {
  const text = unit === "rad" ? `${((180 * value) / Math.PI).toFixed(1)}°` : `${Number(value.toPrecision(5))}${unit && unit !== "cell" ? ` ${unit}` : ""}`;
  return text.replace("-", "−");
}

/** A place in words. @param {number[]} point @param {{axes: Axis[]}} scene */
export const placeOf = (point, { axes }) => point.map((value, a) => `${nameOf(axes[a])} ${coordinateOf(value, axes[a])}`).join(", ");
