// The circuit of a small grid: a symbol for every resistor and supply, over the field.

import { cellOf, isWall, numberOf, sizeOf } from "./model.js";

/** @typedef {import("./frame.js").Circuit} Circuit */
/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {import("./view.js").View} View */

const ROOMY = 44;
const ZIGZAG = new Path2D("M0 0H.28L.317-.09L.39.09L.463-.09L.537.09L.61-.09L.683.09L.72 0H1");
const LEAK = new Path2D("M0 0L-.09-.09L-.15-.07L-.13-.15L-.19-.13L-.17-.21L-.23-.19L-.3-.3M-.37-.26L-.26-.37");
const SLIM = new Path2D("M0 0H.36L.38-.05L.42.05L.46-.05L.5.05L.54-.05L.58.05L.62-.05L.64 0H1");
const FED = new Path2D("M0 0L-.22-.22M-.022-.022L-.11-.044M-.022-.022L-.044-.11");
const SUPPLY = new Path2D("M7 0V7A7 7 0 0 1 7 21A7 7 0 0 1 7 7M7 21V28M0 28H14M2.5 31H11.5M5 34H9M4.5 11.5H9.5M7 9V14");

/** Return a value with an SI prefix and its unit. @param {number} value @param {string} unit @param {number} [digits] */
export function engineering(value, unit, digits = 4) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return `0 ${unit}`;
  const rounded = Number(value.toPrecision(digits)), power = Math.min(9, Math.floor(Math.log10(Math.abs(rounded)) / 3) * 3);
  if (power < -24) return `${value.toExponential(2)} ${unit}`;
  return `${Number((value / 10 ** power).toPrecision(digits))} ${"yzafpnµm kMG"[power / 3 + 8].trim()}${unit}`;
}

/** Return the ends of a resistor in cells; rails lie at the border of their cells.
 * @param {Scene} scene @param {number[]} resistor @param {(cell: number[]) => boolean} isRail */
function ends(scene, [axis, i, j], isRail) {
  return [-1, 1].map((side) => {
    const cell = [i, j], point = [i + 0.5, j + 0.5], border = [i, j][axis], { cells, periodic } = scene.axes[axis];
    if (side < 0) cell[axis] -= 1;
    const isBeyond = cell[axis] < 0 || cell[axis] >= cells;
    point[axis] = border + side * (isBeyond && !periodic ? 0 : !isBeyond && isRail(cell) ? 0.2 : 0.5);
    return point;
  });
}

/** Return the different resistances between nodes, without contacts and leaks. @param {Circuit} circuit */
const valuesOf = ({ resistors, segments }) => [...new Set(segments ? segments.map((one) => Number(one[4].toPrecision(6))) : resistors.map((one) => one[3]))];

/** Draw the resistors of another lattice than square, with a short one at every node with contacts to the obstacle rail.
 * @param {View} view @param {Circuit} circuit @param {string} ink */
function paintLattice(view, { segments = [], contacts = [], nodes = [], fed }, ink) {
  const { context, ratio, matrix } = view, wires = new Path2D();
  for (const [a, b, c, d] of segments) wires.addPath(SLIM, matrix.multiply(new DOMMatrix([c - a, d - b, b - d, c - a, a, b])));
  const turn = view.scene?.lattice === "hexagonal" ? 45 : 22.5; // between the resistors to neighbours
  for (const [x, y] of contacts) wires.addPath(LEAK, matrix.translate(x, y).rotate(turn));
  for (const [x, y] of nodes) {
    view.disc([x, y], 2.5 * ratio);
    view.fill(ink);
    if (fed !== null) wires.addPath(FED, matrix.translate(x, y));
  }
  context.strokeStyle = ink;
  context.lineWidth = Math.max(1, ratio);
  context.setLineDash([]);
  context.stroke(wires);
}

/** @param {View} view @param {Circuit} circuit @param {string} ink */
export function paintCircuit(view, circuit, ink) {
  if (circuit.segments) return paintLattice(view, circuit, ink);
  const scene = /** @type {Scene} */ (view.scene), { context, ratio, matrix } = view, [nx, ny] = sizeOf(scene);
  const goals = new Set(scene.goals.flat()), wires = new Path2D(), isRoomy = matrix.a > ROOMY * ratio;
  const isRail = (/** @type {number[]} */ cell) => goals.has(numberOf(scene, cell)) || isWall(scene, cell);
  const placed = circuit.resistors.map((resistor) => ({ resistor, ends: ends(scene, resistor, isRail) }));
  for (const { ends: [[a, b], [c, d]] } of placed) {
    wires.addPath(ZIGZAG, matrix.multiply(new DOMMatrix([c - a, d - b, b - d, c - a, a, b])));
  }
  const cells = Array.from({ length: nx * ny }, (_, number) => cellOf(scene, number));
  for (const [i, j] of cells.filter((cell) => !isRail(cell))) {
    view.disc([i + 0.5, j + 0.5], 2.5 * ratio);
    view.fill(ink);
    if (circuit.fed !== null || circuit.leak !== null) wires.addPath(circuit.fed === null ? LEAK : FED, matrix.translate(i + 0.5, j + 0.5));
  }
  context.strokeStyle = ink;
  context.lineWidth = Math.max(1, 1.2 * ratio);
  context.lineJoin = "miter";
  context.setLineDash([]);
  context.stroke(wires);
  for (const { resistor: [axis, i, , ohms], ends: [[a, b], [c, d]] } of isRoomy && valuesOf(circuit).length > 1 ? placed : []) {
    const side = i === nx - 1 ? -1 : 1, middle = [(a + c) / 2 + (axis ? 0.12 * side : 0), (b + d) / 2 + (axis ? 0 : 0.16)];
    view.write(engineering(ohms, "Ω", 3), ...view.toPixels(middle), ink, axis ? (side > 0 ? "left" : "right") : "center", 9);
  }
}

/** Draw the supplies of the rails with voltage and current next to the grid. @param {View} view @param {Circuit} circuit
 * @param {ReturnType<typeof import("./pictures.js").inks>} ink @param {{goal: string, start: string}} colours */
export function paintSupplies(view, circuit, ink, colours) {
  const { context, ratio } = view, { supplies, fed, leak } = circuit, values = valuesOf(circuit), [x, y] = view.toPixels(sizeOf(/** @type {Scene} */ (view.scene)));
  const notes = values.length <= (circuit.segments ? 2 : 1) ? values.map((value) => `R = ${engineering(value, "Ω", 3)}`) : [circuit.segments ? "R: under the pointer" : "R: see symbols"];
  if (circuit.contacts?.length) notes.push("stubs: obstacle rail");
  if (fed !== null) notes.push(`↗ ${engineering(fed, "A", 3)} each`);
  if (leak !== null) notes.push(`↗ leak ${engineering(leak, "Ω", 3)}`);
  const say = (/** @type {string} */ text, /** @type {number} */ left, /** @type {number} */ top) => (
    view.write(text, x + left * ratio, y + top * ratio, ink.text, "left", 10));
  notes.forEach((note, n) => say(note, 14, 8 + 14 * n));
  supplies.forEach(({ rail, volts, amperes }, n) => {
    const top = 8 + 14 * notes.length + 63 * n;
    context.setTransform(ratio, 0, 0, ratio, x + 14 * ratio, y + top * ratio);
    context.strokeStyle = ink.text;
    context.lineWidth = 1.2;
    context.stroke(SUPPLY);
    context.fillStyle = rail.startsWith("goal") ? colours.goal : rail === "start" ? colours.start : ink.edge;
    context.fillRect(-1.5, -1.5, 17, 3);
    context.resetTransform();
    const lines = [rail, engineering(volts, "V", 3), `${amperes < 0 ? "sinks" : "sources"} ${engineering(Math.abs(amperes), "A", 3)}`];
    lines.forEach((text, row) => say(text, 34, top + 6 + 11 * row));
  });
}

/** Return the properties of a resistor, as rows. @param {number[]} resistor @returns {[string, string][]} */
export function resistorRows([axis, i, j, ohms, volts, amperes]) {
  const way = amperes === 0 ? "" : [["to the left", "to the right"], ["downwards", "upwards"]][axis][amperes > 0 ? 1 : 0];
  return [
    ["resistor", `${axis ? `${i}, ${j - 1}` : `${i - 1}, ${j}`} – ${i}, ${j}`], ["R", engineering(ohms, "Ω")],
    ["V across it", engineering(Math.abs(volts), "V")], ["I", engineering(Math.abs(amperes), "A")], ["", way],
  ];
}

/** Return the properties of a resistor of another lattice than square, as rows. @param {number[]} segment @returns {[string, string][]} */
export function segmentRows([a, b, c, d, ohms, volts, amperes]) {
  const place = (/** @type {number} */ x, /** @type {number} */ y) => `${Number(x.toFixed(2))}, ${Number(y.toFixed(2))}`;
  const [from, to] = amperes < 0 ? [place(c, d), place(a, b)] : [place(a, b), place(c, d)];
  return [
    ["resistor", `${from} → ${to}`], ["R", engineering(ohms, "Ω")],
    ["V across it", engineering(Math.abs(volts), "V")], ["I", engineering(Math.abs(amperes), "A")],
  ];
}

/** Return the resistor of another lattice than square whose middle third is under a point in cells. @param {Circuit} circuit @param {number[]} point */
export function segmentAt({ segments = [] }, [x, y]) {
  const away = (/** @type {number[]} */ [a, b, c, d]) => Math.hypot((a + c) / 2 - x, (b + d) / 2 - y) / Math.hypot(c - a, d - b);
  const nearest = segments.reduce((/** @type {number[] | null} */ best, one) => (!best || away(one) < away(best) ? one : best), null);
  return nearest && away(nearest) < 0.17 ? nearest : undefined;
}

/** Return the resistor under a point in cells. @param {Circuit} circuit @param {number[]} face that is nearest @param {number[]} point */
export function resistorAt(circuit, [i, j, axis], point) {
  const off = [point[axis] - [i, j][axis], point[1 - axis] - [i, j][1 - axis] - 0.5];
  if (Math.abs(off[0]) > 0.25 || Math.abs(off[1]) > 0.2) return undefined;
  return circuit.resistors.find((resistor) => resistor[0] === axis && resistor[1] === i && resistor[2] === j);
}
