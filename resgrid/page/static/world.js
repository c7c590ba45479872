// The workspace of an arm: what stands there can be dragged, and the arm goes along its first path.

import { inks } from "./pictures.js";
import { stepOf } from "./tools.js";
import { GOAL, keepSharp, pixelRatio, pixelUnder } from "./view.js";

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {{shape?: string, lower?: number[], upper?: number[], centre?: number[], radius?: number,
 *   vertices?: number[][], point?: number[]}} Shape */
/** @typedef {["obstacle" | "goal", number]} Thing what can be moved: its list, and its number there */
/** @typedef {number[][]} Pose the arm's joints, from its base to its tip */

const ARM = "#2f6fdb", POSES_A_SECOND = 12, GHOSTS = 9, KEY_PIXELS = 8, REACH = 0.46;

/** A shape moved in the plane. @param {Shape} shape @param {number[]} by @returns {Shape} */
function moved(shape, by) {
  const shift = (/** @type {number[]} */ point) => point.map((value, a) => Number((value + by[a]).toPrecision(12)));
  const copy = { ...shape };
  for (const key of /** @type {const} */ (["lower", "upper", "centre", "point"])) if (shape[key]) copy[key] = shift(shape[key]);
  if (shape.vertices) copy.vertices = shape.vertices.map(shift);
  return copy;
}

export class World {
  /** @type {Scene | null} */ scene = null;
  /** @type {Pose[]} */ poses = [];
  /** @type {Pose | null} */ hovered = null;
  dark = false;
  canDraw = true;
  /** @type {{thing: Thing, from: number[], first: Scene} | null} */ #drag = null;
  /** What arrow keys move. */ #chosen = 0;

  /** @param {HTMLCanvasElement} canvas @param {import("./model.js").Model} model @param {() => Promise<void>} resample */
  constructor(canvas, model, resample) {
    this.canvas = canvas;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { alpha: false }));
    this.model = model;
    this.resample = resample;
    keepSharp(canvas);
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => this.#end());
    canvas.addEventListener("keydown", (event) => this.#key(event));
  }

  /** @param {Scene} scene */
  setScene(scene) {
    if (!scene.world) this.poses = [];
    this.scene = scene.world ? scene : null;
  }

  get #document() {
    return /** @type {any} */ (this.scene?.world);
  }

  /** Pixels a metre, and where the origin is. */
  get #frame() {
    const { links, base } = this.#document.robot, { width, height } = this.canvas;
    const reach = links.reduce((/** @type {number} */ sum, /** @type {{length: number}} */ link) => sum + link.length, 0);
    const scale = (REACH * Math.min(width, height)) / reach;
    return { scale, x: width / 2 - base[0] * scale, y: height / 2 + base[1] * scale };
  }

  /** @param {number[]} point @returns {[number, number]} */
  #pixels([a, b]) {
    const { scale, x, y } = this.#frame;
    return [x + a * scale, y - b * scale];
  }

  /** A point of the workspace under the pointer. @param {PointerEvent} event */
  #place(event) {
    const [px, py] = pixelUnder(this.canvas, event), { scale, x, y } = this.#frame;
    return [(px - x) / scale, (y - py) / scale];
  }

  /** @param {number[][]} points */
  #polyline(points) {
    const path = new Path2D();
    for (const point of points) path.lineTo(...this.#pixels(point));
    return path;
  }

  /** @param {number[]} centre @param {number} radius in pixels */
  #disc(centre, radius) {
    const path = new Path2D();
    path.arc(...this.#pixels(centre), radius, 0, 2 * Math.PI);
    return path;
  }

  /** @param {Shape} shape */
  #outline({ centre, radius, point, vertices, lower: [a, b] = [0, 0], upper: [c, d] = [0, 0] }) {
    if (centre && radius) return this.#disc(centre, radius * this.#frame.scale);
    if (point) return this.#disc(point, 8);
    const path = this.#polyline(vertices ?? [[a, b], [c, b], [c, d], [a, d]]);
    path.closePath();
    return path;
  }

  /** All that can be moved: goals in the workspace, then obstacles. @returns {Thing[]} */
  get #things() {
    const lists = /** @type {const} */ (["goal", "obstacle"]);
    return lists.flatMap((list) => (this.#document[list] ?? []).map((/** @type {Shape} */ _, /** @type {number} */ n) => [list, n]));
  }

  /** @param {Path2D} path @param {string} colour @param {number} width @param {number[]} [dash] */
  #stroke(path, colour, width, dash = []) {
    const { context } = this;
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.stroke(path);
  }

  /** @param {number} now */
  paint(now) {
    if (!this.scene) return;
    const { context, poses, canvas: { width, height } } = this, { robot, obstacle = [], goal = [] } = this.#document, ink = inks(this.dark);
    const fine = width / 450, ratio = pixelRatio(), last = poses.length - 1;
    context.fillStyle = ink.back;
    context.fillRect(0, 0, width, height);
    this.#stroke(this.#disc(robot.base, REACH * Math.min(width, height)), ink.edge, 1, [4, 6]);
    context.fillStyle = ink.label;
    context.font = `${11 * ratio}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.fillText("the arm's workspace", width / 2, 16 * ratio);
    context.fillStyle = ink.edge;
    for (const shape of obstacle) context.fill(this.#outline(shape));
    for (const shape of goal) if (!shape.joints && !shape.cell && !shape.joints_lower) this.#stroke(this.#outline(shape), GOAL, 3 * fine);
    const chosen = this.canvas.matches(":focus-visible") ? this.#things[this.#chosen] : undefined;
    if (chosen) this.#stroke(this.#outline(this.#document[chosen[0]][chosen[1]]), ARM, 3 * fine, [6, 4]);
    const every = Math.max(1, Math.round(last / GHOSTS)), at = Math.floor((now / 1000) * POSES_A_SECOND) % (last + POSES_A_SECOND);
    if (last > 0) {
      poses.forEach((pose, n) => n % every === 0 && this.#paintArm(pose, 0.16, fine));
      this.#stroke(this.#polyline(poses.map((pose) => pose[pose.length - 1])), GOAL, 2 * fine);
    }
    const standing = this.hovered ?? (last > 0 ? poses[Math.min(last, at)] : null);
    if (standing) this.#paintArm(standing, 1, fine);
  }

  /** @param {Pose} pose @param {number} opacity @param {number} fine */
  #paintArm(pose, opacity, fine) {
    const { context } = this;
    context.globalAlpha = opacity;
    context.fillStyle = ARM;
    context.lineCap = context.lineJoin = "round";
    this.#stroke(this.#polyline(pose), ARM, 6 * fine);
    if (opacity === 1) for (const joint of pose) context.fill(this.#disc(joint, 6 * fine));
    context.globalAlpha = 1;
  }

  /** @param {PointerEvent} event */
  #down(event) {
    if (!this.scene || !this.canDraw || event.button !== 0 || this.model.before) return;
    const [x, y] = pixelUnder(this.canvas, event);
    this.context.lineWidth = 16;
    const thing = this.#things.find(([list, number]) => {
      const outline = this.#outline(this.#document[list][number]);
      return this.context.isPointInPath(outline, x, y) || this.context.isPointInStroke(outline, x, y);
    });
    if (!thing) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.model.begin();
    this.#drag = { thing, from: this.#place(event), first: this.scene };
  }

  /** Space chooses the next thing, arrows move it. @param {KeyboardEvent} event */
  async #key(event) {
    const step = stepOf(event);
    if (!this.scene || !this.canDraw || (event.key !== " " && !step)) return;
    event.preventDefault();
    if (!step) this.#chosen = (this.#chosen + 1) % this.#things.length;
    const thing = this.#things[this.#chosen];
    if (!step || !thing || this.#drag) return;
    this.model.begin();
    this.#shift(this.scene, thing, step.map((part) => (part * KEY_PIXELS) / this.#frame.scale));
    await this.resample();
    this.model.commit();
  }

  /** Move one thing of a scene. @param {Scene} first @param {Thing} thing @param {number[]} by metres */
  #shift(first, [list, number], by) {
    const world = /** @type {any} */ (first.world);
    const shapes = world[list].map((/** @type {Shape} */ shape, /** @type {number} */ n) => (n === number ? moved(shape, by) : shape));
    this.model.show({ world: { ...world, [list]: shapes } });
  }

  /** @param {PointerEvent} event */
  #move(event) {
    if (!this.#drag || !this.model.scene) return;
    const { thing, from, first } = this.#drag, to = this.#place(event);
    this.#shift(first, thing, [to[0] - from[0], to[1] - from[1]]);
    this.resample();
  }

  async #end() {
    if (!this.#drag) return;
    this.#drag = null;
    await this.resample();
    this.model.commit();
  }
}
