// Tools: what pointer, finger and keys do on the canvas.

import { cellAt, insideOf, numberOf, OBSTACLE, sizeOf } from "./model.js";
import { brushed, costing, faceAt, flood, free, goalMoved, line, rectangle, startMoved, wall, withBroken, withConductivity, withGoal,
  without, withStart } from "./shapes.js";

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {import("./shapes.js").Stroke} Stroke */

const ICONS = {
  draw: '<path d="M3 17l1-4L14 3l3 3L7 16z"/>',
  erase: '<path d="M3 13l7-9 7 5-6 8H6z M8 17h9"/>',
  box: '<rect x="3" y="5" width="14" height="10"/>',
  fill: '<path d="M9 2l7 7-6 6-7-7z M17 13v3"/>',
  cost: '<path d="M2 7q4-4 8 0t8 0M2 12q4-4 8 0t8 0M2 17q4-4 8 0t8 0"/>',
  goal: '<path d="M5 18V3h10l-3 4 3 4H5"/>',
  start: '<circle cx="10" cy="10" r="6"/>',
  look: '<path d="M2 10q8-11 16 0q-8 11-16 0z"/><circle cx="10" cy="10" r="2"/>',
  snap: '<path d="M2 10h4l2-4 2 8 M18 10h-4l-2 4-2-8"/>',
};
export const TOOLS = [
  ["draw", "Wall", "Draw walls; a stroke that begins on a wall erases (W)"],
  ["erase", "Erase", "Erase walls and costs (E)"],
  ["box", "Box", "A rectangle of wall; from a wall, of free cells (B)"],
  ["fill", "Fill", "Fill what is alike and joined (F)"],
  ["cost", "Mud", "Paint cells that conduct badly (M)"],
  ["goal", "Goal", "Add a goal; on a goal, remove it (G)"],
  ["start", "Start", "Add a start; on a start, remove it (S)"],
  ["snap", "Break", "Break the resistor between two cells, or mend it (X)"],
  ["look", "Look", "See what is known of a cell; nothing is drawn (L)"],
];
const KEYS = { w: "draw", e: "erase", b: "box", f: "fill", m: "cost", g: "goal", s: "start", x: "snap", l: "look" };
const REACH = 16;

/** @typedef {{move: (cell: number[]) => void, end: () => void}} Gesture */

export class Tools {
  tool = "draw";
  brush = 2;
  conductivity = 0.1;
  canDraw = true;
  /** @type {Gesture | null} */ #gesture = null;

  /** @param {import("./model.js").Model} model @param {import("./view.js").View} view */
  constructor(model, view) {
    this.model = model;
    this.view = view;
    const { canvas } = view;
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => this.#end());
    canvas.addEventListener("keydown", (event) => this.#key(event));
  }

  get busy() {
    return this.#gesture !== null;
  }

  /** Buttons of the tools. @param {HTMLElement} bar */
  fill(bar) {
    for (const [name, label, about] of TOOLS) {
      const button = document.createElement("button");
      button.dataset.tool = name;
      button.title = about;
      const icon = ICONS[/** @type {keyof typeof ICONS} */ (name)];
      button.innerHTML = `<svg viewBox="0 0 20 20" fill="none" stroke="currentColor" stroke-width="2" aria-hidden="true">${icon}</svg>`;
      button.append(label);
      button.addEventListener("click", () => this.choose(name));
      bar.append(button);
    }
    this.bar = bar;
    this.choose(this.tool);
  }

  /** @param {string} tool */
  choose(tool) {
    this.tool = tool;
    for (const button of this.bar?.querySelectorAll("button") ?? []) {
      button.setAttribute("aria-pressed", String(button.dataset.tool === tool));
    }
  }

  /** The cell under the pointer, which may lie outside. @param {PointerEvent} event */
  #cell(event) {
    return this.view.pointOf(event).map(Math.floor);
  }

  /** @param {PointerEvent} event */
  #down(event) {
    if (event.button !== 0 || !this.model.scene || this.#gesture) return;
    this.view.canvas.setPointerCapture(event.pointerId);
    if (this.tool === "snap" && this.canDraw) this.#snap(this.view.pointOf(event));
    else this.#begin(this.#cell(event), this.#handleAt(event));
  }

  /** @param {PointerEvent} event */
  #move(event) {
    if (!this.#gesture) return;
    for (const step of event.getCoalescedEvents?.().slice(0, -1) ?? []) this.#gesture.move(this.#cell(step));
    this.#gesture.move(this.#cell(event));
  }

  #end() {
    this.#gesture?.end();
    this.#gesture = null;
    this.view.rectangle = null;
    this.model.commit();
  }

  /** @param {number[]} point in cells */
  #snap(point) {
    const scene = /** @type {Scene} */ (this.model.scene);
    if (insideOf(scene, point.map(Math.floor))) this.model.replace(withBroken(scene, faceAt(scene, point)));
  }

  /** A goal or start near the pointer. @param {PointerEvent} event @returns {["goals" | "starts", number] | null} */
  #handleAt(event) {
    const scene = /** @type {Scene} */ (this.model.scene), { view } = this;
    const around = view.canvas.getBoundingClientRect(), ratio = view.canvas.width / around.width;
    const at = [(event.clientX - around.left) * ratio, (event.clientY - around.top) * ratio];
    const near = (/** @type {number[]} */ point) => {
      const [px, py] = view.toPixels(point);
      return Math.hypot(px - at[0], py - at[1]) < REACH * Math.min(2, window.devicePixelRatio || 1);
    };
    const start = scene.starts.findIndex((point) => near(view.startPoint(point)));
    if (start >= 0) return ["starts", start];
    const number = numberOf(scene, view.pointOf(event).map(Math.floor));
    const goal = scene.goals.findIndex((cells) => near(view.goalPoint(cells)) || cells.includes(number));
    return goal >= 0 ? ["goals", goal] : null;
  }

  /** @param {number[]} cell @param {["goals" | "starts", number] | null} handle */
  #begin(cell, handle) {
    this.model.begin();
    this.#gesture = handle ? this.#drag(cell, ...handle) : this.canDraw && this.tool !== "look" ? this.#stroke(cell) : null;
    if (!this.#gesture) this.model.commit();
  }

  /** Move a goal or a start; its own tool removes it where it is not moved.
   * @param {number[]} from @param {"goals" | "starts"} list @param {number} number @returns {Gesture | null} */
  #drag(from, list, number) {
    const first = /** @type {Scene} */ (this.model.scene);
    if (!this.canDraw && list === "goals") return null;
    const own = this.canDraw && this.tool === (list === "goals" ? "goal" : "start");
    let moved = false;
    return {
      move: (cell) => {
        if (cell[0] === from[0] && cell[1] === from[1] && !moved) return;
        moved = true;
        const by = [cell[0] - from[0], cell[1] - from[1]];
        this.model.show(list === "goals" ? goalMoved(first, number, by) : startMoved(first, number, cell));
      },
      end: () => {
        if (own && !moved) this.model.show(without(first, list, number));
      },
    };
  }

  /** @param {number[]} cell @returns {Gesture | null} */
  #stroke(cell) {
    const { model } = this, first = /** @type {Scene} */ (model.scene), inside = insideOf(first, cell);
    const none = { move: () => {}, end: () => {} };
    if (this.tool === "goal" || this.tool === "start") {
      if (!inside) return null;
      model.show(this.tool === "goal" ? withGoal(first, inside) : withStart(first, inside));
      return none;
    }
    const onWall = inside && first.cells[numberOf(first, inside)] & OBSTACLE;
    const [scene, stroke] = this.#strokeOf(first, Boolean(onWall));
    if (this.tool === "fill") {
      if (!inside) return null;
      model.show(brushed(scene, [...flood(scene, inside)], stroke));
      return none;
    }
    if (this.tool === "box") return this.#box(scene, cell, stroke);
    let last = cell;
    model.show(brushed(scene, line(cell, cell, this.brush), stroke));
    return {
      move: (next) => {
        if (next[0] === last[0] && next[1] === last[1]) return;
        model.show(brushed(/** @type {Scene} */ (model.scene), line(last, next, this.brush), stroke));
        last = next;
      },
      end: () => {},
    };
  }

  /** What the tool does to a cell. @param {Scene} scene @param {boolean} onWall @returns {[Scene, Stroke]} */
  #strokeOf(scene, onWall) {
    if (this.tool === "cost") {
      const [with_, level] = withConductivity(scene, this.conductivity);
      return [with_, costing(level)];
    }
    if (this.tool === "erase") return [scene, (byte) => free(costing(scene.palette.indexOf(1) >= 0 ? scene.palette.indexOf(1) : 0)(byte))];
    return [scene, onWall ? free : wall];
  }

  /** @param {Scene} scene @param {number[]} from @param {Stroke} stroke @returns {Gesture} */
  #box(scene, from, stroke) {
    const show = (/** @type {number[]} */ cell) => {
      const size = sizeOf(scene);
      const to = cell.map((part, a) => Math.max(-1, Math.min(size[a], part)));
      this.view.rectangle = [from, to];
      this.model.show(brushed(scene, rectangle(from, to), stroke));
    };
    show(from);
    return { move: show, end: () => {} };
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const scene = this.model.scene;
    if (!scene || event.ctrlKey || event.metaKey || event.altKey) return;
    const tool = KEYS[/** @type {keyof typeof KEYS} */ (event.key.toLowerCase())];
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (tool && this.canDraw) this.choose(tool);
    else if (step) this.#walk(scene, step, event.shiftKey);
    else if (event.key === " " || event.key === "Enter") this.#use(scene);
    else if (event.key === "Escape") return;
    else return;
    event.preventDefault();
  }

  /** Move the cursor; with shift it takes along the goal or start on its cell. @param {Scene} scene @param {number[]} by @param {boolean} takes */
  #walk(scene, by, takes) {
    const from = this.view.cursor ?? sizeOf(scene).map((size) => Math.floor(size / 2));
    const to = insideOf(scene, [from[0] + by[0], from[1] + by[1]]) ?? from;
    const handle = takes ? this.#handleOn(scene, from) : null;
    this.view.cursor = to;
    this.view.canvas.dispatchEvent(new CustomEvent("walk", { detail: to }));
    if (!handle) return;
    this.#begin(from, handle);
    this.#gesture?.move(to);
    this.#end();
  }

  /** @param {Scene} scene @param {number[]} cell @returns {["goals" | "starts", number] | null} */
  #handleOn(scene, cell) {
    const number = numberOf(scene, cell);
    const start = scene.starts.findIndex((point) => numberOf(scene, cellAt(scene, point)) === number);
    if (start >= 0) return ["starts", start];
    const goal = scene.goals.findIndex((cells) => cells.includes(number));
    return goal >= 0 ? ["goals", goal] : null;
  }

  /** Use the tool at the cursor; the second use of the box is its other corner. @param {Scene} scene */
  #use(scene) {
    const cell = this.view.cursor ?? sizeOf(scene).map((size) => Math.floor(size / 2));
    this.view.cursor = cell;
    if (this.tool === "snap") return this.#snap([cell[0] + 0.9, cell[1] + 0.5]);
    const handle = this.#handleOn(scene, cell), own = handle?.[0] === `${this.tool}s`;
    this.#begin(cell, own ? handle : null);
    return this.#end();
  }
}
