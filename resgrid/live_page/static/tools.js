// Tools: actions of pointer, touch and keys on the canvas.

import { make } from "./layout.js";
import { cellAt, insideOf, isWall, numberOf, sizeOf } from "./model.js";
import { brushed, costing, faceAt, flood, free, goalMoved, line, rectangle, startMoved, wall, withBroken, withConductivity, withGoal,
  without, withStart } from "./shapes.js";
import { stepOf } from "./surface.js";

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {import("./shapes.js").Stroke} Stroke */
/** @typedef {["goals" | "starts", number]} Handle */
/** @typedef {import("./surface.js").Gesture} Gesture */

/** Name, label, key, description and icon of every tool. */
export const TOOLS = [
  ["draw", "Wall", "W", "Draw walls; erase them if the stroke begins on a wall", '<path d="M3 17l1-4L14 3l3 3L7 16z"/>'],
  ["erase", "Erase", "E", "Erase walls and costs", '<path d="M3 13l7-9 7 5-6 8H6z M8 17h9"/>'],
  ["box", "Box", "B", "Draw a rectangular wall; erase a rectangle if it begins on a wall", '<rect x="3" y="5" width="14" height="10"/>'],
  ["fill", "Fill", "F", "Fill all connected cells of the same kind", '<path d="M9 2l7 7-6 6-7-7z M17 13v3"/>'],
  ["cost", "Mud", "M", "Paint cells of low conductivity", '<path d="M2 7q4-4 8 0t8 0M2 12q4-4 8 0t8 0M2 17q4-4 8 0t8 0"/>'],
  ["goal", "Goal", "G", "Add a goal, or remove the goal under the pointer", '<path d="M5 18V3h10l-3 4 3 4H5"/>'],
  ["start", "Start", "S", "Add a start, or remove the start under the pointer", '<circle cx="10" cy="10" r="6"/>'],
  ["snap", "Break", "X", "Open the resistor between two cells, or repair it", '<path d="M2 10h4l2-4 2 8 M18 10h-4l-2 4-2-8"/>'],
  ["look", "Look", "L", "Show the properties of a cell without drawing; a click pins it to the scope", '<path d="M2 10q8-11 16 0q-8 11-16 0z"/><circle cx="10" cy="10" r="2"/>'],
];
const REACH = 16;

export class Tools {
  tool = "draw";
  brush = 2;
  conductivity = 0.1;
  canDraw = true;

  /** @param {import("./model.js").Model} model @param {import("./view.js").View} view @param {HTMLElement} bar for its buttons */
  constructor(model, view, bar) {
    this.model = model;
    this.view = view;
    this.bar = bar;
    view.hear((point) => this.#press(point));
    view.canvas.addEventListener("keydown", (event) => this.#key(event));
    for (const [name, label, key, about, icon] of TOOLS) {
      const button = make("button", { title: `${about} (${key})`, onclick: () => this.choose(name) });
      button.innerHTML = `<svg viewBox="0 0 20 20" fill="none" stroke="currentColor" stroke-width="2" aria-hidden="true">${icon}</svg>${label}`;
      button.dataset.tool = name;
      bar.append(button);
    }
    this.choose(this.tool);
  }

  /** @param {string} tool */
  choose(tool) {
    if (/** @type {HTMLButtonElement} */ (this.bar.querySelector(`[data-tool="${tool}"]`)).disabled) return;
    this.tool = tool;
    for (const button of this.bar.querySelectorAll("button")) button.ariaPressed = String(button.dataset.tool === tool);
  }

  /** Enable a tool, or disable it with the reason as its tooltip. @param {string} tool @param {string} reason empty if it is enabled */
  allow(tool, reason) {
    const button = /** @type {HTMLButtonElement} */ (this.bar.querySelector(`[data-tool="${tool}"]`));
    const [, , key, about] = /** @type {string[]} */ (TOOLS.find(([name]) => name === tool));
    button.disabled = Boolean(reason);
    button.title = reason || `${about} (${key})`;
    if (reason && this.tool === tool) this.choose("draw");
  }

  get #scene() {
    return /** @type {Scene} */ (this.model.scene);
  }

  /** Begin a gesture at a point in cells, which may lie outside the grid. @param {number[]} point @returns {Gesture | null} */
  #press(point) {
    if (!this.model.scene) return null;
    if (this.tool === "snap" && this.canDraw) return this.#snap(point);
    const cell = point.map(Math.floor), gesture = this.#begin(cell, this.#handleAt(point));
    return gesture && { move: (next) => gesture.move?.(next.map(Math.floor)), end: () => this.#end(gesture) };
  }

  /** @param {Gesture | null} gesture */
  #end(gesture) {
    gesture?.end?.();
    this.view.rectangle = null;
    this.model.commit();
  }

  /** @param {number[]} point in cells */
  #snap(point) {
    if (insideOf(this.#scene, point.map(Math.floor))) this.model.replace(withBroken(this.#scene, faceAt(this.#scene, point)));
    return null;
  }

  /** Return the first start, or otherwise goal, that satisfies a condition.
   * @param {(start: number[]) => boolean} isStart @param {(goal: number[]) => boolean} isGoal @returns {Handle | null} */
  #handle(isStart, isGoal) {
    const start = this.#scene.starts.findIndex(isStart), goal = this.#scene.goals.findIndex(isGoal);
    return start >= 0 ? ["starts", start] : goal >= 0 ? ["goals", goal] : null;
  }

  /** Return a goal or start near a point. @param {number[]} point */
  #handleAt(point) {
    const { view } = this, [x, y] = view.toPixels(point), number = numberOf(this.#scene, point.map(Math.floor));
    const isNear = (/** @type {number[]} */ other) => {
      const [px, py] = view.toPixels(other);
      return Math.hypot(px - x, py - y) < REACH * view.ratio;
    };
    return this.#handle((start) => isNear(view.startPoint(start)), (goal) => isNear(view.goalPoint(goal)) || goal.includes(number));
  }

  /** Return a goal or start on a cell. @param {number[]} cell */
  #handleOn(cell) {
    const number = numberOf(this.#scene, cell);
    return this.#handle((start) => numberOf(this.#scene, cellAt(this.#scene, start)) === number, (goal) => goal.includes(number));
  }

  /** @param {number[]} cell @param {Handle | null} handle @returns {Gesture | null} */
  #begin(cell, handle) {
    this.model.begin();
    const gesture = handle ? this.#drag(cell, ...handle) : this.canDraw && this.tool !== "look" ? this.#stroke(cell) : null;
    const looked = this.tool === "look" && !handle && insideOf(this.#scene, cell);
    if (looked) this.view.canvas.dispatchEvent(new CustomEvent("pin", { detail: looked }));
    if (!gesture) this.model.commit();
    return gesture;
  }

  /** Move a goal or a start; a click with its own tool removes it.
   * @param {number[]} from @param {"goals" | "starts"} list @param {number} number @returns {Gesture | null} */
  #drag(from, list, number) {
    const first = this.#scene, isOwn = this.canDraw && `${this.tool}s` === list;
    if (!this.canDraw && list === "goals") return null;
    let isMoved = false;
    return {
      move: (cell) => {
        const by = [cell[0] - from[0], cell[1] - from[1]];
        isMoved ||= by.some((step) => step !== 0);
        if (isMoved) this.model.show(list === "goals" ? goalMoved(first, number, by) : startMoved(first, number, cell));
      },
      end: () => {
        if (isOwn && !isMoved) this.model.show(without(first, list, number));
      },
    };
  }

  /** @param {number[]} cell @returns {Gesture | null} */
  #stroke(cell) {
    const { model, tool } = this, first = this.#scene, inside = insideOf(first, cell);
    if (!inside && ["goal", "start", "fill"].includes(tool)) return null;
    const [scene, stroke] = this.#strokeOf(first, inside !== null && isWall(first, inside));
    let last = cell;
    const paint = (/** @type {Iterable<number[]>} */ cells) => model.show(brushed({ ...this.#scene, palette: scene.palette }, cells, stroke));
    const span = (/** @type {number[]} */ next) => {
      const to = next.map((part, a) => Math.max(-1, Math.min(sizeOf(first)[a], part)));
      this.view.rectangle = [cell, to];
      model.show(brushed(scene, rectangle(cell, to), stroke));
    };
    const draw = (/** @type {number[]} */ next) => {
      if (next === last || next.some((part, a) => part !== last[a])) paint(line(last, next, this.brush));
      last = next;
    };
    if (tool === "goal") model.show(withGoal(first, /** @type {number[]} */ (inside)));
    else if (tool === "start") model.show(withStart(first, /** @type {number[]} */ (inside)));
    else if (tool === "fill") paint([...flood(scene, /** @type {number[]} */ (inside))]);
    else {
      const move = tool === "box" ? span : draw;
      move(cell);
      return { move };
    }
    return {};
  }

  /** Return the scene with the conductivity in its palette, and the change of a cell by the tool. @param {Scene} scene @param {boolean} isOnWall @returns {[Scene, Stroke]} */
  #strokeOf(scene, isOnWall) {
    if (this.tool === "cost") {
      const [changed, level] = withConductivity(scene, this.conductivity);
      return [changed, costing(level)];
    }
    if (this.tool === "erase") return [scene, (byte) => free(costing(Math.max(0, scene.palette.indexOf(1)))(byte))];
    return [scene, isOnWall ? free : wall];
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    if (!this.model.scene || event.ctrlKey || event.metaKey || event.altKey) return;
    const tool = TOOLS.find(([, , key]) => key === event.key.toUpperCase()), step = stepOf(event);
    if (tool && this.canDraw) this.choose(tool[0]);
    else if (step) this.#walk(step, event.shiftKey);
    else if (event.key === " " || event.key === "Enter") this.#use();
    else return;
    event.preventDefault();
  }

  /** Cell of the keyboard cursor, initially the middle of the grid. */
  get #cursor() {
    return this.view.cursor ?? sizeOf(this.#scene).map((size) => Math.floor(size / 2));
  }

  /** Move the cursor, and, with shift, the goal or start on its cell. @param {number[]} by @param {boolean} takes */
  #walk(by, takes) {
    const from = this.#cursor, to = insideOf(this.#scene, [from[0] + by[0], from[1] + by[1]]) ?? from;
    const handle = takes ? this.#handleOn(from) : null;
    this.view.cursor = to;
    this.view.canvas.dispatchEvent(new CustomEvent("walk", { detail: to }));
    if (!handle) return;
    const gesture = this.#begin(from, handle);
    gesture?.move?.(to);
    this.#end(gesture);
  }

  /** Apply the tool at the cursor. */
  #use() {
    const cell = this.#cursor, handle = this.#handleOn(cell);
    this.view.cursor = cell;
    if (this.tool === "snap") this.#snap([cell[0] + 0.9, cell[1] + 0.5]);
    else this.#end(this.#begin(cell, handle?.[0] === `${this.tool}s` ? handle : null));
  }
}
