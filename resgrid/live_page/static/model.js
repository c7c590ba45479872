// The model of the page: an immutable scene with its undo history, and its conversion from and to messages.

/**
 * @typedef {{name: string, lower: number, upper: number, cells: number, periodic: boolean, unit: string}} Axis
 * @typedef {object} Scene
 * @property {string} title
 * @property {Axis[]} axes two of them
 * @property {string[]} edge
 * @property {number[]} palette conductivities
 * @property {number[][]} starts in axis units
 * @property {number} k
 * @property {number} wall ohms
 * @property {string} [lattice] square, square8 or hexagonal
 * @property {number} [leak] to the obstacle rail, in 1 / (unit of the axes)^2
 * @property {boolean} driven
 * @property {object} chip
 * @property {number[][]} broken open resistors, as cell and axis: the resistor at the cell's lower face
 * @property {object | null} world for an arm, the document of its scene
 * @property {Uint8Array} cells one byte per cell, x first: 1 for an obstacle, + 4 x index of its conductivity
 * @property {number[][]} goals cell numbers of every goal, stored separately from cells
 * @property {number[][]} [goal_points] configurations that solve the goal: cell number and point
 */

export const OBSTACLE = 1;
const GOAL = 2;
const KEPT_BYTES = 64e6;

/** @param {Scene} scene */
export const sizeOf = (scene) => [scene.axes[0].cells, scene.axes[1].cells];
/** @param {Scene} scene @param {number[]} cell */
export const numberOf = (scene, [i, j]) => i * scene.axes[1].cells + j;
/** @param {Scene} scene @param {number} number @returns {[number, number]} */
export const cellOf = (scene, number) => [Math.floor(number / scene.axes[1].cells), number % scene.axes[1].cells];
/** @param {Scene} scene @param {number[]} cell */
export const isWall = (scene, cell) => Boolean(scene.cells[numberOf(scene, cell)] & OBSTACLE);
/** @param {Axis} axis */
export const spacingOf = (axis) => (axis.upper - axis.lower) / axis.cells;

/** Return a cell with indices wrapped along periodic axes; null outside the grid. @param {Scene} scene @param {number[]} cell */
export function insideOf(scene, cell) {
  const wrapped = cell.map((part, a) => {
    const { cells, periodic } = scene.axes[a];
    return periodic ? ((part % cells) + cells) % cells : part;
  });
  return wrapped.every((part, a) => part >= 0 && part < scene.axes[a].cells) ? wrapped : null;
}

/** Return the cell of a point in axis units. @param {Scene} scene @param {number[]} point */
export const cellAt = (scene, point) => point.map((value, a) => {
  const axis = scene.axes[a];
  return Math.min(axis.cells - 1, Math.max(0, Math.floor((value - axis.lower) / spacingOf(axis))));
});

/** Return the centre of a cell in axis units. @param {Scene} scene @param {number[]} cell */
export const centreOf = (scene, cell) => cell.map((part, a) => scene.axes[a].lower + (part + 0.5) * spacingOf(scene.axes[a]));

/** Return the scene of a message. @param {any} head @param {Uint8Array} body @returns {Scene} */
export function readScene(head, body) {
  const cells = body.slice();
  for (const goal of head.goals) for (const number of goal) cells[number] &= ~3;
  return { ...head.drawing, cells, goals: head.goals };
}

/** Return head and body of a message with a scene. @param {Scene} scene @returns {[object, Uint8Array]} */
export function writeScene(scene) {
  const { cells, goals, ...drawing } = scene;
  const body = cells.slice();
  for (const goal of goals) for (const number of goal) body[number] = (body[number] & ~3) | GOAL;
  return [drawing, body];
}

/** Return bytes as base64 text. @param {Uint8Array} bytes */
export const base64 = (bytes) => btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
/** Return the bytes of a base64 text. @param {string} text */
export const bytesIn = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

/** Return a scene as text, for the browser's storage. @param {Scene} scene */
export const keepScene = (scene) => JSON.stringify({ ...scene, cells: base64(scene.cells) });

/** Return the scene of a text by keepScene. @param {string} text @returns {Scene} */
export function keptScene(text) {
  const scene = JSON.parse(text);
  return { ...scene, cells: bytesIn(scene.cells) };
}

/** Return whether two scenes are equal. @param {any} one @param {any} other */
function areAlike(one, other) {
  const keys = new Set([...Object.keys(one), ...Object.keys(other)]);
  return [...keys].every((key) => {
    const a = one[key], b = other[key];
    if (a === b) return true;
    if (!(a instanceof Uint8Array)) return JSON.stringify(a) === JSON.stringify(b);
    return b instanceof Uint8Array && a.length === b.length && a.every((byte, n) => byte === b[n]);
  });
}

/** The scene on the page with its undo history. Dispatches "change", and "rest" after a gesture without a change. */
export class Model extends EventTarget {
  /** @type {Scene | null} */ scene = null;
  /** @type {Scene[]} */ past = [];
  /** @type {Scene[]} */ future = [];
  /** @type {Scene | null} */ before = null;

  /** Change some properties of the scene, as one undo step and with one event. @param {Partial<Scene>} change */
  replace(change) {
    this.begin();
    this.scene = this.#changed(change);
    this.commit();
  }

  /** Set a scene and clear the undo history. @param {Scene} scene */
  reset(scene) {
    this.past = this.future = [];
    this.before = null;
    this.#set(scene, true);
  }

  /** Begin a gesture. */
  begin() {
    this.before ??= this.scene;
  }

  /** Change the scene within a gesture; equal scenes are ignored. @param {Partial<Scene>} change */
  show(change) {
    const scene = this.#changed(change);
    if (scene !== this.scene) this.#set(scene, false);
  }

  /** End a gesture, as one undo step unless the scene is unchanged. */
  commit() {
    const { before } = this;
    if (!before || before === this.scene) {
      this.before = null;
      this.dispatchEvent(new CustomEvent("rest"));
      return;
    }
    if (areAlike(before, /** @type {Scene} */ (this.scene))) this.scene = before;
    else {
      const kept = Math.max(20, Math.floor(KEPT_BYTES / before.cells.length));
      this.past = [...this.past, before].slice(-kept);
      this.future = [];
    }
    this.before = null;
    this.#set(this.scene, true);
  }

  /** Undo or redo. @param {"past" | "future"} from history of the next scene: past for undo, future for redo */
  step(from) {
    const to = from === "past" ? "future" : "past", scene = this[from].at(-1);
    if (!scene || !this.scene || this.before) return;
    this[from] = this[from].slice(0, -1);
    this[to] = [...this[to], this.scene];
    this.#set(scene, true);
  }

  /** Return the scene with some properties changed; the present object if nothing changes. @param {Partial<Scene>} change */
  #changed(change) {
    const present = /** @type {Scene} */ (this.scene), scene = { ...present, ...change };
    return areAlike(scene, present) ? present : scene;
  }

  /** @param {Scene | null} scene @param {boolean} settled */
  #set(scene, settled) {
    this.scene = scene;
    this.dispatchEvent(new CustomEvent("change", { detail: { settled } }));
  }
}
