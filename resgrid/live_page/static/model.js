// What is drawn: an immutable scene, the steps that led to it, and how it travels.

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
 * @property {boolean} driven
 * @property {object} chip
 * @property {number[][]} broken resistors: a cell, and the axis across whose lower face they lie
 * @property {object | null} world of an arm, the document of its scene
 * @property {Uint8Array} cells one byte a cell, x first: 1 for an obstacle, + 4 x number of its conductivity
 * @property {number[][]} goals cell numbers of every goal; goals stand on top of cells
 * @property {number[][]} [goal_points] cell numbers of goals that are more than a cell, each with the point where a path ends
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

/** A cell wrapped round periodic axes; null outside the grid. @param {Scene} scene @param {number[]} cell */
export function insideOf(scene, cell) {
  const wrapped = cell.map((part, a) => {
    const { cells, periodic } = scene.axes[a];
    return periodic ? ((part % cells) + cells) % cells : part;
  });
  return wrapped.every((part, a) => part >= 0 && part < scene.axes[a].cells) ? wrapped : null;
}

/** The cell that a point in axis units lies in. @param {Scene} scene @param {number[]} point */
export const cellAt = (scene, point) => point.map((value, a) => {
  const axis = scene.axes[a];
  return Math.min(axis.cells - 1, Math.max(0, Math.floor((value - axis.lower) / spacingOf(axis))));
});

/** The centre of a cell in axis units. @param {Scene} scene @param {number[]} cell */
export const centreOf = (scene, cell) => cell.map((part, a) => scene.axes[a].lower + (part + 0.5) * spacingOf(scene.axes[a]));

/** A scene from the head and body of a message. @param {any} head @param {Uint8Array} body @returns {Scene} */
export function readScene(head, body) {
  const cells = body.slice();
  for (const goal of head.goals) for (const number of goal) cells[number] &= ~3;
  return { ...head.drawing, cells, goals: head.goals };
}

/** The head and body of a message. @param {Scene} scene @returns {[object, Uint8Array]} */
export function writeScene(scene) {
  const { cells, goals, ...drawing } = scene;
  const body = cells.slice();
  for (const goal of goals) for (const number of goal) body[number] = (body[number] & ~3) | GOAL;
  return [drawing, body];
}

/** Bytes as text. @param {Uint8Array} bytes */
export const base64 = (bytes) => btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
/** The inverse of base64. @param {string} text */
export const bytesIn = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));

/** A scene as text, for keeping. @param {Scene} scene */
export const keepScene = (scene) => JSON.stringify({ ...scene, cells: base64(scene.cells) });

/** The inverse of keepScene. @param {string} text @returns {Scene} */
export function keptScene(text) {
  const scene = JSON.parse(text);
  return { ...scene, cells: bytesIn(scene.cells) };
}

/** Whether two scenes are the same drawing. @param {any} one @param {any} other */
function areAlike(one, other) {
  const keys = new Set([...Object.keys(one), ...Object.keys(other)]);
  return [...keys].every((key) => {
    const a = one[key], b = other[key];
    if (a === b) return true;
    if (!(a instanceof Uint8Array)) return JSON.stringify(a) === JSON.stringify(b);
    return b instanceof Uint8Array && a.length === b.length && a.every((byte, n) => byte === b[n]);
  });
}

/** The scene on the page, and the way back. It tells of a "change", and of a "rest" where a gesture has changed nothing. */
export class Model extends EventTarget {
  /** @type {Scene | null} */ scene = null;
  /** @type {Scene[]} */ past = [];
  /** @type {Scene[]} */ future = [];
  /** @type {Scene | null} */ before = null;

  /** Show another scene, or change something of it; it can be undone. @param {Partial<Scene>} change */
  replace(change) {
    this.begin();
    this.show(change);
    this.commit();
  }

  /** Begin afresh. @param {Scene} scene */
  reset(scene) {
    this.past = this.future = [];
    this.before = null;
    this.#set(scene, true);
  }

  /** A gesture begins. */
  begin() {
    this.before ??= this.scene;
  }

  /** What the gesture has made so far; nothing happens where that is what is there already. @param {Partial<Scene>} change */
  show(change) {
    const scene = { .../** @type {Scene} */ (this.scene), ...change };
    if (!areAlike(scene, /** @type {Scene} */ (this.scene))) this.#set(scene, false);
  }

  /** The gesture ends: one step to be undone, unless it has changed nothing. */
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

  /** @param {"past" | "future"} from where the scene comes from: undo or redo */
  step(from) {
    const to = from === "past" ? "future" : "past", scene = this[from].at(-1);
    if (!scene || !this.scene || this.before) return;
    this[from] = this[from].slice(0, -1);
    this[to] = [...this[to], this.scene];
    this.#set(scene, true);
  }

  /** @param {Scene | null} scene @param {boolean} settled */
  #set(scene, settled) {
    this.scene = scene;
    this.dispatchEvent(new CustomEvent("change", { detail: { settled } }));
  }
}
