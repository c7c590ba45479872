// The workspace of an arm: its obstacles and goals can be dragged, and the arm moves along its first path.

import { colours } from "./colours.js";
import { inks } from "./pictures.js";
import { stepOf, Surface } from "./surface.js";

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {{shape?: string, lower?: number[], upper?: number[], centre?: number[], radius?: number,
 *   vertices?: number[][], point?: number[]}} Shape */
/** @typedef {["obstacle" | "goal", number]} Thing movable object: its list and index */
/** @typedef {number[][]} Pose positions of the arm's joints, from base to tip */

const ARM = "#2f6fdb", POSES_A_SECOND = 12, GHOSTS = 9, KEY_PIXELS = 8, POINT_PIXELS = 8;
/** Margin of the workspace in CSS pixels. */
const LEFT = 46, RIGHT = 14, TOP = 28, BOTTOM = 40;
const MARGIN = 1.04, TICK = 36;
const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10];

/** Return a shape moved in the plane. @param {Shape} shape @param {number[]} by @returns {Shape} */
function moved(shape, by) {
  const shift = (/** @type {number[]} */ point) => point.map((value, a) => Number((value + by[a]).toPrecision(12)));
  const copy = { ...shape };
  for (const key of /** @type {const} */ (["lower", "upper", "centre", "point"])) if (shape[key]) copy[key] = shift(shape[key]);
  if (shape.vertices) copy.vertices = shape.vertices.map(shift);
  return copy;
}

/** @param {CanvasPath} path @param {number[][]} points */
function tracePolyline(path, points) {
  points.forEach(([x, y], n) => (n ? path.lineTo(x, y) : path.moveTo(x, y)));
}

/** @param {CanvasPath} path @param {Shape} shape @param {number} dot radius of points, in metres */
function traceShape(path, { centre, radius, point, vertices, lower: [a, b] = [0, 0], upper: [c, d] = [0, 0] }, dot) {
  const [x, y] = centre ?? point ?? [];
  if (x !== undefined) return path.arc(x, y, radius ?? dot, 0, 2 * Math.PI);
  tracePolyline(path, vertices ?? [[a, b], [c, b], [c, d], [a, d]]);
  return path.closePath();
}

export class World extends Surface {
  /** @type {Scene | null} */ scene = null;
  /** @type {Pose[]} */ poses = [];
  /** @type {Pose | null} */ hovered = null;
  canDraw = true;
  /** Index of the object that arrow keys move. */ #chosen = 0;

  /** @param {HTMLCanvasElement} canvas @param {import("./model.js").Model} model @param {() => Promise<void>} resample */
  constructor(canvas, model, resample) {
    super(canvas);
    this.model = model;
    this.resample = resample;
    this.hear((from) => this.#take(from));
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

  /** Reach of the arm, in metres. */
  get #reach() {
    return this.#document.robot.links.reduce((/** @type {number} */ sum, /** @type {{length: number}} */ link) => sum + link.length, 0);
  }

  /** Transformation from metres to pixels, with the arm's base in the middle. */
  get matrix() {
    if (!this.scene) return new DOMMatrix();
    const { ratio, canvas: { width, height } } = this, [x, y] = this.#document.robot.base;
    const w = width - (LEFT + RIGHT) * ratio, h = height - (TOP + BOTTOM) * ratio, scale = Math.max(1, Math.min(w, h)) / (2 * MARGIN * this.#reach);
    return new DOMMatrix([scale, 0, 0, -scale, LEFT * ratio + w / 2 - x * scale, TOP * ratio + h / 2 + y * scale]);
  }

  /** All movable objects: goals in the workspace, then obstacles. @returns {Thing[]} */
  get #things() {
    const lists = /** @type {const} */ (["goal", "obstacle"]);
    return lists.flatMap((list) => (this.#document[list] ?? []).map((/** @type {Shape} */ _, /** @type {number} */ n) => [list, n]));
  }

  /** @param {Thing} thing @returns {Shape} */
  #shape([list, number]) {
    return this.#document[list][number];
  }

  /** @param {Shape} shape */
  #trace(shape) {
    this.inUnits((context) => traceShape(context, shape, POINT_PIXELS / this.matrix.a));
  }

  /** @param {number} now */
  paint(now) {
    if (!this.scene) return;
    const { context, poses, canvas: { width, height } } = this, { robot, obstacle = [], goal = [] } = this.#document;
    const ink = inks(this.dark), fine = width / 450, last = poses.length - 1;
    context.fillStyle = ink.back;
    context.fillRect(0, 0, width, height);
    this.inUnits(() => context.arc(robot.base[0], robot.base[1], this.#reach, 0, 2 * Math.PI));
    this.stroke(ink.edge, 1, [4, 6]);
    this.#paintAxes(ink.edge, ink.label);
    for (const shape of obstacle) {
      this.#trace(shape);
      this.fill(ink.edge);
    }
    for (const shape of goal.filter((/** @type {any} */ one) => !one.joints && !one.cell && !one.joints_lower)) {
      this.#trace(shape);
      this.stroke(colours.goal, 3 * fine);
    }
    const chosen = this.canvas.matches(":focus-visible") ? this.#things[this.#chosen] : undefined;
    if (chosen) {
      this.#trace(this.#shape(chosen));
      this.stroke(ARM, 3 * fine, [6, 4]);
    }
    if (last > 0) {
      const every = Math.max(1, Math.round(last / GHOSTS));
      poses.forEach((pose, n) => n % every === 0 && this.#paintArm(pose, 0.16, fine));
      this.inUnits(() => tracePolyline(context, poses.map((pose) => pose[pose.length - 1])));
      this.stroke(colours.goal, 2 * fine);
    }
    const at = Math.floor((now / 1000) * POSES_A_SECOND) % (last + POSES_A_SECOND);
    const standing = this.hovered ?? (last > 0 ? poses[Math.min(last, at)] : null);
    if (standing) this.#paintArm(standing, 1, fine);
  }

  /** Paint the axes of the workspace, in metres. @param {string} edge @param {string} label */
  #paintAxes(edge, label) {
    const { context, ratio } = this, [x, y] = this.#document.robot.base, far = MARGIN * this.#reach;
    const [left, bottom] = this.toPixels([x - far, y - far]), [right, top] = this.toPixels([x + far, y + far]);
    this.inUnits(() => context.rect(x - far, y - far, 2 * far, 2 * far));
    this.stroke(edge, 1.5);
    const step = STEPS.find((one) => one * this.matrix.a > TICK * ratio) ?? 2 * far;
    for (const a of [0, 1]) {
      const middle = [x, y][a];
      for (let n = Math.ceil((middle - far) / step); n * step <= middle + far; n++) {
        const [px, py] = this.toPixels(a ? [x, n * step] : [n * step, y]), text = String(Number((n * step).toPrecision(6))).replace("-", "−");
        context.beginPath();
        context.moveTo(a ? left : px, a ? py : bottom);
        context.lineTo(a ? left - 4 * ratio : px, a ? py : bottom + 4 * ratio);
        this.stroke(edge, 1.5);
        this.write(text, a ? left - 7 * ratio : px, a ? py : bottom + 12 * ratio, label, a ? "right" : "center", 10);
      }
    }
    this.write("x (m)", (left + right) / 2, bottom + 28 * ratio, label);
    context.save();
    context.translate(left - 34 * ratio, (top + bottom) / 2);
    context.rotate(-Math.PI / 2);
    this.write("y (m)", 0, 0, label);
    context.restore();
    this.write("the arm's workspace", (left + right) / 2, top - 12 * ratio, label);
  }

  /** @param {Pose} pose @param {number} opacity @param {number} fine */
  #paintArm(pose, opacity, fine) {
    const { context } = this;
    context.globalAlpha = opacity;
    context.lineCap = context.lineJoin = "round";
    this.inUnits(() => tracePolyline(context, pose));
    this.stroke(ARM, 6 * fine);
    for (const joint of opacity === 1 ? pose : []) {
      this.disc(joint, 6 * fine);
      this.fill(ARM);
    }
    context.globalAlpha = 1;
  }

  /** Begin to drag the object near a point. @param {number[]} from @returns {import("./surface.js").Gesture | null} */
  #take(from) {
    const first = this.scene, thing = first && this.canDraw && !this.model.before && this.#thingAt(from);
    if (!first || !thing) return null;
    this.model.begin();
    return {
      move: (to) => {
        this.#shift(first, thing, [to[0] - from[0], to[1] - from[1]]);
        this.resample();
      },
      end: () => this.#put(),
    };
  }

  /** @param {number[]} point in metres */
  #thingAt([x, y]) {
    const { context, matrix: { a: scale } } = this;
    context.lineWidth = (2 * POINT_PIXELS) / scale;
    return this.#things.find((thing) => {
      const outline = new Path2D();
      traceShape(outline, this.#shape(thing), POINT_PIXELS / scale);
      return context.isPointInPath(outline, x, y) || context.isPointInStroke(outline, x, y);
    });
  }

  /** Handle keys: space selects the next object, arrows move it. @param {KeyboardEvent} event */
  #key(event) {
    const step = stepOf(event);
    if (!this.scene || !this.canDraw || (event.key !== " " && !step)) return;
    event.preventDefault();
    if (!step) this.#chosen = (this.#chosen + 1) % this.#things.length;
    const thing = this.#things[this.#chosen];
    if (!step || !thing) return;
    this.model.begin();
    this.#shift(this.scene, thing, step.map((part) => (part * KEY_PIXELS) / this.matrix.a));
    this.#put();
  }

  /** Move an object of a scene. @param {Scene} first @param {Thing} thing @param {number[]} by metres */
  #shift(first, [list, number], by) {
    const world = /** @type {any} */ (first.world);
    const shapes = world[list].map((/** @type {Shape} */ shape, /** @type {number} */ n) => (n === number ? moved(shape, by) : shape));
    this.model.show({ world: { ...world, [list]: shapes } });
  }

  /** End a drag. */
  async #put() {
    await this.resample();
    this.model.commit();
  }
}
