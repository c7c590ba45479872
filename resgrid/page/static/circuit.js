// The circuit of a small grid: a symbol for every resistor and supply, over the field.

import { numberOf, OBSTACLE, sizeOf } from "./model.js";

/** @typedef {import("./frame.js").Circuit} Circuit */
/** @typedef {import("./view.js").View} View */

const ROOMY = 44;
const ZIGZAG = new Path2D("M0 0H.28L.317-.09L.39.09L.463-.09L.537.09L.61-.09L.683.09L.72 0H1");
const FED = new Path2D("M0 0L-.22-.22M-.022-.022L-.11-.044M-.022-.022L-.044-.11");
const SUPPLY = new Path2D("M7 0V7A7 7 0 0 1 7 21A7 7 0 0 1 7 7M7 21V28M0 28H14M2.5 31H11.5M5 34H9M4.5 11.5H9.5M7 9V14");

/** A number with a prefix. @param {number} value @param {string} unit @param {number} [digits] */
export function engineering(value, unit, digits = 4) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return `0 ${unit}`;
  const power = Math.min(9, Math.floor(Math.log10(Math.abs(value)) / 3) * 3);
  if (power < -24) return `${value.toExponential(2)} ${unit}`;
  return `${Number((value / 10 ** power).toPrecision(digits))} ${"yzafpnµm kMG"[power / 3 + 8].trim()}${unit}`;
}

/** Where the ends of a resistor are, in cells: rails lie at the border of their cells.
 * @param {View} view @param {number[]} resistor @param {(cell: number[]) => boolean} isRail */
function ends({ scene }, [axis, i, j], isRail) {
  return [-1, 1].map((side) => {
    const cell = [i, j], point = [i + 0.5, j + 0.5], border = [i, j][axis];
    if (side < 0) cell[axis] -= 1;
    const { cells, periodic } = /** @type {import("./model.js").Scene} */ (scene).axes[axis];
    const isBeyond = cell[axis] < 0 || cell[axis] >= cells;
    point[axis] = border + side * (isBeyond && !periodic ? 0 : !isBeyond && isRail(cell) ? 0.2 : 0.5);
    return point;
  });
}

/** @param {View} view @param {Circuit} circuit @param {string} ink */
export function paintCircuit(view, circuit, ink) {
  const scene = /** @type {import("./model.js").Scene} */ (view.scene), { context, ratio } = view, { w, h } = view.box;
  const goals = new Set(scene.goals.flat()), wires = new Path2D(), nodes = new Path2D(), [nx, ny] = sizeOf(scene);
  const isRail = (/** @type {number[]} */ cell) => goals.has(numberOf(scene, cell)) || Boolean(scene.cells[numberOf(scene, cell)] & OBSTACLE);
  const isVaried = new Set(circuit.resistors.map((resistor) => resistor[3])).size > 1, labels = [];
  for (const resistor of circuit.resistors) {
    const [[a, b], [c, d]] = ends(view, resistor, isRail), [x, y] = view.toPixels([a, b]), dx = (c - a) * w, dy = (b - d) * h;
    wires.addPath(ZIGZAG, new DOMMatrix([dx, dy, -dy, dx, x, y]));
    labels.push([resistor[0], resistor[1], resistor[3], x + dx / 2, y + dy / 2]);
  }
  for (let i = 0; i < nx; i++) {
    for (let j = 0; j < ny; j++) {
      if (isRail([i, j])) continue;
      const [x, y] = view.toPixels([i + 0.5, j + 0.5]);
      nodes.moveTo(x, y);
      nodes.arc(x, y, 2.5 * ratio, 0, 2 * Math.PI);
      if (circuit.fed !== null) wires.addPath(FED, new DOMMatrix([w, 0, 0, -h, x, y]));
    }
  }
  context.strokeStyle = context.fillStyle = ink;
  context.lineWidth = Math.max(1, 1.2 * ratio);
  context.lineJoin = "miter";
  context.stroke(wires);
  context.fill(nodes);
  if (!isVaried || w < ROOMY * ratio) return;
  context.font = `${9 * ratio}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  for (const [axis, i, ohms, x, y] of labels) {
    const side = i === nx - 1 ? -1 : 1;
    context.textAlign = axis ? (side > 0 ? "left" : "right") : "center";
    context.fillText(engineering(ohms, "Ω", 3), axis ? x + 0.12 * side * w : x, axis ? y : y - 0.16 * w);
  }
}

/** Rails and what they give, as symbols beside the grid, in pixels of the page from a corner.
 * @param {CanvasRenderingContext2D} context @param {Circuit} circuit @param {string} ink @param {(rail: string) => string} colour */
export function paintSupplies(context, { resistors, supplies, fed }, ink, colour) {
  const values = new Set(resistors.map((resistor) => resistor[3]));
  const notes = [values.size === 1 ? `R = ${engineering([...values][0], "Ω", 3)}` : "R as written"];
  if (fed !== null) notes.push(`↗ ${engineering(fed, "A", 3)} each`);
  context.font = "10px system-ui, sans-serif";
  context.textAlign = "left";
  context.textBaseline = "middle";
  context.strokeStyle = context.fillStyle = ink;
  context.lineWidth = 1.2;
  notes.forEach((note, n) => context.fillText(note, 0, 14 * n));
  context.translate(0, 14 * notes.length);
  for (const { rail, volts, amperes } of supplies) {
    context.stroke(SUPPLY);
    context.fillStyle = colour(rail);
    context.fillRect(-1.5, -1.5, 17, 3);
    context.fillStyle = ink;
    const lines = [rail, engineering(volts, "V", 3), `${amperes < 0 ? "takes" : "gives"} ${engineering(Math.abs(amperes), "A", 3)}`];
    lines.forEach((text, row) => context.fillText(text, 20, 6 + 11 * row));
    context.translate(0, 63);
  }
}

/** What is known of a resistor, as rows. @param {number[]} resistor @returns {[string, string][]} */
export function resistorRows([axis, i, j, ohms, volts, amperes]) {
  const way = amperes === 0 ? "" : [["to the left", "to the right"], ["downwards", "upwards"]][axis][amperes > 0 ? 1 : 0];
  return [
    ["resistor", `${axis ? `${i}, ${j - 1}` : `${i - 1}, ${j}`} – ${i}, ${j}`], ["R", engineering(ohms, "Ω")],
    ["V across it", engineering(Math.abs(volts), "V")], ["I", engineering(Math.abs(amperes), "A")], ["", way],
  ];
}

/** The resistor under a point in cells. @param {Circuit} circuit @param {number[]} face that is nearest @param {number[]} point */
export function resistorAt(circuit, [i, j, axis], point) {
  const off = [point[axis] - [i, j][axis], point[1 - axis] - [i, j][1 - axis] - 0.5];
  if (Math.abs(off[0]) > 0.25 || Math.abs(off[1]) > 0.2) return undefined;
  return circuit.resistors.find((resistor) => resistor[0] === axis && resistor[1] === i && resistor[2] === j);
}
