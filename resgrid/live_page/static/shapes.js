// Functions from a scene to a changed scene.

import { cellOf, centreOf, insideOf, numberOf, OBSTACLE, sizeOf } from "./model.js";

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {(byte: number) => number} Stroke change of a cell's byte */

/** @type {Stroke} */ export const wall = (byte) => byte | OBSTACLE;
/** @type {Stroke} */ export const free = (byte) => byte & ~OBSTACLE;
/** @param {number} level @returns {Stroke} */
export const costing = (level) => (byte) => (byte & 3) | (level << 2);

/** Return the scene with a conductivity in its palette, and its index. @param {Scene} scene @param {number} value @returns {[Scene, number]} */
export function withConductivity(scene, value) {
  const level = scene.palette.indexOf(value);
  if (level >= 0) return [scene, level];
  return [{ ...scene, palette: [...scene.palette, value] }, scene.palette.length];
}

/** @param {Scene} scene @param {Iterable<number[]>} cells @param {Stroke} stroke @returns {Scene} */
export function brushed(scene, cells, stroke) {
  const changed = scene.cells.slice();
  for (const cell of cells) {
    const inside = insideOf(scene, cell);
    if (inside) {
      const number = numberOf(scene, inside);
      changed[number] = stroke(changed[number]);
    }
  }
  return { ...scene, cells: changed };
}

/** Yield the cells of a brush stroke from one cell to another. @param {number[]} from @param {number[]} to @param {number} size */
export function* line(from, to, size) {
  const steps = Math.max(Math.abs(to[0] - from[0]), Math.abs(to[1] - from[1]), 1), low = -Math.floor((size - 1) / 2);
  for (let s = 0; s <= steps; s++) {
    const i = Math.round(from[0] + ((to[0] - from[0]) * s) / steps);
    const j = Math.round(from[1] + ((to[1] - from[1]) * s) / steps);
    for (let a = low; a < low + size; a++) for (let b = low; b < low + size; b++) yield [i + a, j + b];
  }
}

/** @param {number[]} one @param {number[]} other */
export function* rectangle(one, other) {
  for (let i = Math.min(one[0], other[0]); i <= Math.max(one[0], other[0]); i++) {
    for (let j = Math.min(one[1], other[1]); j <= Math.max(one[1], other[1]); j++) yield [i, j];
  }
}

/** Yield all connected cells with the same byte as a cell. @param {Scene} scene @param {number[]} cell */
export function* flood(scene, cell) {
  const first = numberOf(scene, cell), like = scene.cells[first];
  const seen = new Uint8Array(scene.cells.length), stack = [first];
  seen[first] = 1;
  while (stack.length) {
    const here = cellOf(scene, /** @type {number} */ (stack.pop()));
    yield here;
    for (const [a, b] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
      const next = insideOf(scene, [here[0] + a, here[1] + b]);
      const number = next ? numberOf(scene, next) : -1;
      if (number >= 0 && !seen[number] && scene.cells[number] === like) {
        seen[number] = 1;
        stack.push(number);
      }
    }
  }
}

/** @param {Scene} scene @param {number[]} cell */
export const withGoal = (scene, cell) => ({ ...scene, goals: [...scene.goals, [numberOf(scene, cell)]] });
/** @param {Scene} scene @param {number[]} cell */
export const withStart = (scene, cell) => ({ ...scene, starts: [...scene.starts, centreOf(scene, cell)] });
/** @param {Scene} scene @param {"goals" | "starts"} list @param {number} number */
export const without = (scene, list, number) => ({ ...(list === "goals" ? whole(scene, number) : scene), [list]: scene[list].filter((_, n) => n !== number) });

/** Return the scene without the goal points of a goal, so that its whole cells are the goal. @param {Scene} scene @param {number} number @returns {Scene} */
const whole = (scene, number) => ({ ...scene, goal_points: (scene.goal_points ?? []).filter(([cell]) => !scene.goals[number].includes(cell)) });

/** Return the scene with a goal moved by whole cells, limited to the grid. @param {Scene} scene @param {number} number @param {number[]} by */
export function goalMoved(scene, number, by) {
  const cells = scene.goals[number].map((n) => cellOf(scene, n));
  const within = by.map((step, a) => {
    if (scene.axes[a].periodic) return step;
    const places = cells.map((cell) => cell[a]);
    return Math.max(-Math.min(...places), Math.min(sizeOf(scene)[a] - 1 - Math.max(...places), step));
  });
  const moved = cells.map((cell) => numberOf(scene, /** @type {number[]} */ (insideOf(scene, [cell[0] + within[0], cell[1] + within[1]]))));
  return { ...whole(scene, number), goals: scene.goals.map((goal, n) => (n === number ? moved : goal)) };
}

/** Return the scene with a start moved to the centre of a cell. @param {Scene} scene @param {number} number @param {number[]} cell */
export function startMoved(scene, number, cell) {
  const within = cell.map((part, a) => Math.max(0, Math.min(sizeOf(scene)[a] - 1, part)));
  return { ...scene, starts: scene.starts.map((start, n) => (n === number ? centreOf(scene, within) : start)) };
}

/** Return the face nearest to a point, as cell and axis. @param {Scene} scene @param {number[]} point in cells */
export function faceAt(scene, point) {
  const cell = point.map(Math.floor), local = point.map((value, a) => value - cell[a]);
  const far = local.map((value) => Math.min(value, 1 - value)), axis = far[0] <= far[1] ? 0 : 1;
  if (local[axis] > 0.5) cell[axis] += 1;
  if (scene.axes[axis].periodic && cell[axis] === sizeOf(scene)[axis]) cell[axis] = 0;
  return [...cell, axis];
}

/** Return the scene with a resistor opened, or repaired. @param {Scene} scene @param {number[]} face @returns {Scene} */
export function withBroken(scene, face) {
  const rest = scene.broken.filter((other) => other.some((part, a) => part !== face[a]));
  return { ...scene, broken: rest.length < scene.broken.length ? rest : [...rest, face] };
}
