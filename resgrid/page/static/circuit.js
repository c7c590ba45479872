// The circuit of a small grid: a symbol for every resistor and supply, over the field.

import { engineering } from "./panel.js";

/** @typedef {import("./frame.js").Circuit} Circuit */
/** @typedef {(point: number[]) => number[]} Place pixels of a point in cells */

const TEETH = 6, ROOMY = 44;

/** The line and zigzag of a resistor. @param {CanvasRenderingContext2D} context @param {number[]} from @param {number[]} to */
function zigzag(context, [x0, y0], [x1, y1]) {
  const dx = x1 - x0, dy = y1 - y0, at = (/** @type {number} */ t, /** @type {number} */ side) => context.lineTo(x0 + t * dx - side * dy, y0 + t * dy + side * dx);
  context.moveTo(x0, y0);
  at(0.28, 0);
  for (let n = 0; n < TEETH; n++) at(0.28 + (0.44 * (n + 0.5)) / TEETH, n % 2 ? 0.09 : -0.09);
  at(0.72, 0);
  at(1, 0);
}

/** Where the ends of a resistor are, in cells: rails lie at the border of their cells.
 * @param {number[]} resistor @param {number[]} size @param {boolean[]} periodic @param {(cell: number[]) => boolean} isRail */
function ends([axis, i, j], size, periodic, isRail) {
  return [-1, 1].map((side) => {
    const cell = [i, j], point = [i + 0.5, j + 0.5];
    if (side < 0) cell[axis] -= 1;
    point[axis] = [i, j][axis] + 0.5 * side;
    const beyond = cell[axis] < 0 || cell[axis] >= size[axis];
    if (beyond && !periodic[axis]) point[axis] = [i, j][axis];
    else if (!beyond && isRail(cell)) point[axis] = [i, j][axis] + 0.2 * side;
    return point;
  });
}

/** @param {CanvasRenderingContext2D} context @param {Circuit} circuit @param {Place} place @param {number} cell its pixels
 * @param {{size: number[], periodic: boolean[], isRail: (cell: number[]) => boolean, isFree: (cell: number[]) => boolean, ratio: number, ink: string}} about */
export function paintCircuit(context, circuit, place, cell, { size, periodic, isRail, isFree, ratio, ink }) {
  const texts = new Map(), spread = new Set(circuit.resistors.map((resistor) => resistor[3]));
  context.strokeStyle = context.fillStyle = ink;
  context.lineWidth = Math.max(1, 1.2 * ratio);
  context.lineJoin = "miter";
  context.beginPath();
  for (const resistor of circuit.resistors) {
    const [from, to] = ends(resistor, size, periodic, isRail);
    zigzag(context, place(from), place(to));
    texts.set(resistor, from.map((part, a) => (part + to[a]) / 2));
  }
  context.stroke();
  context.beginPath();
  for (let i = 0; i < size[0]; i++) {
    for (let j = 0; j < size[1]; j++) {
      if (!isFree([i, j])) continue;
      const [x, y] = place([i + 0.5, j + 0.5]), far = 0.22 * cell;
      context.moveTo(x, y);
      context.arc(x, y, 2.5 * ratio, 0, 2 * Math.PI);
      if (circuit.fed === null) continue;
      context.moveTo(x, y);
      context.lineTo(x - far, y + far);
      for (const [a, b] of [[0.4, 0.1], [0.1, 0.4]]) {
        context.moveTo(x - 0.1 * far, y + 0.1 * far);
        context.lineTo(x - (0.1 + a) * far, y + (0.1 + b) * far);
      }
    }
  }
  context.stroke();
  context.fill();
  if (spread.size < 2 || cell < ROOMY * ratio) return;
  context.font = `${9 * ratio}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  for (const [[axis, i, , ohms], middle] of texts) {
    const [x, y] = place(middle), side = i === size[0] - 1 ? -1 : 1;
    context.textAlign = axis ? (side > 0 ? "left" : "right") : "center";
    context.fillText(brief(ohms, "Ω"), axis ? x + 0.12 * side * cell : x, axis ? y : y - 0.16 * cell);
  }
}

/** Rails and what they give, as symbols beside the grid. @param {CanvasRenderingContext2D} context @param {Circuit} circuit
 * @param {number} x @param {number} y @param {number} ratio @param {string} ink @param {(rail: string) => string} colour */
export function paintSupplies(context, circuit, x, y, ratio, ink, colour) {
  const u = 7 * ratio, values = new Set(circuit.resistors.map((resistor) => resistor[3]));
  const notes = [values.size === 1 ? `R = ${brief([...values][0], "Ω")}` : "R as written"];
  if (circuit.fed !== null) notes.push(`↗ ${brief(circuit.fed, "A")} each`);
  context.font = `${10 * ratio}px system-ui, sans-serif`;
  context.textAlign = "left";
  context.textBaseline = "middle";
  context.fillStyle = ink;
  notes.forEach((note, n) => context.fillText(note, x, y + 2 * n * u));
  circuit.supplies.forEach(({ rail, volts, amperes }, n) => {
    const top = y + (2 * notes.length + 9 * n) * u, middle = x + u;
    context.lineWidth = 3 * ratio;
    context.strokeStyle = colour(rail);
    context.beginPath();
    context.moveTo(x - 0.2 * u, top);
    context.lineTo(x + 2.2 * u, top);
    context.stroke();
    context.lineWidth = 1.2 * ratio;
    context.strokeStyle = ink;
    context.beginPath();
    context.moveTo(middle, top);
    context.lineTo(middle, top + u);
    context.moveTo(middle + u, top + 2 * u);
    context.arc(middle, top + 2 * u, u, 0, 2 * Math.PI);
    context.moveTo(middle, top + 3 * u);
    context.lineTo(middle, top + 4 * u);
    for (const [half, down] of [[1, 4], [0.65, 4.45], [0.3, 4.9]]) {
      context.moveTo(middle - half * u, top + down * u);
      context.lineTo(middle + half * u, top + down * u);
    }
    context.stroke();
    context.textAlign = "center";
    context.fillText("+", middle, top + 1.6 * u);
    context.textAlign = "left";
    const lines = [rail, brief(volts, "V"), `${amperes < 0 ? "takes" : "gives"} ${brief(Math.abs(amperes), "A")}`];
    lines.forEach((text, row) => context.fillText(text, x + 2.8 * u, top + (0.9 + 1.6 * row) * u));
  });
}

/** Three digits and a prefix. @param {number} value @param {string} unit */
const brief = (value, unit) => engineering(Number(value.toPrecision(3)), unit);

/** What is known of a resistor, as rows. @param {number[]} resistor @returns {[string, string][]} */
export function resistorRows([axis, i, j, ohms, volts, amperes]) {
  const way = amperes === 0 ? "" : [["to the left", "to the right"], ["downwards", "upwards"]][axis][amperes > 0 ? 1 : 0];
  return [
    ["resistor", `${axis ? `${i}, ${j - 1}` : `${i - 1}, ${j}`} – ${i}, ${j}`], ["R", engineering(ohms, "Ω")],
    ["V across it", engineering(Math.abs(volts), "V")], ["I", engineering(Math.abs(amperes), "A")], ["", way],
  ];
}

/** The resistor under a point in cells. @param {Circuit} circuit @param {number[]} face that is nearest @param {number[]} point */
export function resistorAt(circuit, face, point) {
  const [axis] = face.slice(2), off = [point[axis] - face[axis], point[1 - axis] - face[1 - axis] - 0.5];
  if (Math.abs(off[0]) > 0.25 || Math.abs(off[1]) > 0.2) return undefined;
  return circuit.resistors.find((resistor) => resistor[0] === axis && resistor[1] === face[0] && resistor[2] === face[1]);
}
