// The workspace of an arm: what stands there can be dragged, and the arm goes along its first path.

import { inks } from "./colours.js";

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {{shape?: string, lower?: number[], upper?: number[], centre?: number[], radius?: number,
 *   vertices?: number[][], point?: number[]}} Shape */
/** @typedef {number[][]} Pose the arm's joints, from its base to its tip */

const GOAL = "#ff5d3b", ARM = "#2f6fdb", POSES_A_SECOND = 12, GHOSTS = 9, KEY_PIXELS = 8;

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
  /** @type {{list: "obstacle" | "goal", number: number, from: number[], first: Scene} | null} */ #drag = null;
  canDraw = true;
  /** What arrow keys move. */ #chosen = 0;

  /** @param {HTMLCanvasElement} canvas @param {import("./model.js").Model} model @param {() => Promise<void>} resample
   * @param {import("./view.js").View} view */
  constructor(canvas, model, resample, view) {
    this.canvas = canvas;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { alpha: false }));
    this.model = model;
    this.resample = resample;
    this.view = view;
    new ResizeObserver(() => this.#resize()).observe(canvas);
    canvas.addEventListener("pointerdown", (event) => this.#down(event));
    canvas.addEventListener("pointermove", (event) => this.#move(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => this.#end());
    canvas.addEventListener("keydown", (event) => this.#key(event));
    const loop = (/** @type {number} */ now) => {
      if (view.isClosed) return;
      if (this.scene) this.#paint(now);
      requestAnimationFrame(loop);
    };
    requestAnimationFrame(loop);
  }

  /** @param {Scene} scene */
  setScene(scene) {
    if (this.scene?.world !== scene.world && !scene.world) this.poses = [];
    this.scene = scene.world ? scene : null;
  }

  #resize() {
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    this.canvas.width = Math.max(1, Math.round(this.canvas.clientWidth * ratio));
    this.canvas.height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
  }

  get #document() {
    return /** @type {any} */ (this.scene?.world);
  }

  /** Pixels a metre, and where the base is. */
  get #frame() {
    const { robot } = this.#document, { width, height } = this.canvas;
    const reach = robot.links.reduce((/** @type {number} */ sum, /** @type {{length: number}} */ link) => sum + link.length, 0);
    const scale = (0.46 * Math.min(width, height)) / reach;
    return { scale, x: width / 2 - robot.base[0] * scale, y: height / 2 + robot.base[1] * scale };
  }

  /** @param {number[]} point */
  #pixels([a, b]) {
    const { scale, x, y } = this.#frame;
    return /** @type {[number, number]} */ ([x + a * scale, y - b * scale]);
  }

  /** @param {PointerEvent} event */
  #place(event) {
    const around = this.canvas.getBoundingClientRect(), ratio = this.canvas.width / around.width, { scale, x, y } = this.#frame;
    return [((event.clientX - around.left) * ratio - x) / scale, (y - (event.clientY - around.top) * ratio) / scale];
  }

  /** @param {Shape} shape */
  #outline(shape) {
    const path = new Path2D(), { scale } = this.#frame;
    if (shape.centre && shape.radius) {
      const [x, y] = this.#pixels(shape.centre);
      path.arc(x, y, shape.radius * scale, 0, 2 * Math.PI);
    } else if (shape.point) {
      const [x, y] = this.#pixels(shape.point);
      path.arc(x, y, 8, 0, 2 * Math.PI);
    } else {
      const [low, high] = [shape.lower ?? [0, 0], shape.upper ?? [0, 0]];
      const corners = shape.vertices ?? [low, [high[0], low[1]], high, [low[0], high[1]]];
      corners.forEach((corner, n) => (n ? path.lineTo(...this.#pixels(corner)) : path.moveTo(...this.#pixels(corner))));
      path.closePath();
    }
    return path;
  }

  /** @param {number} now */
  #paint(now) {
    const { context } = this, document_ = this.#document, ink = inks(this.view.dark), fine = this.canvas.width / 450;
    context.fillStyle = ink.back;
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    context.strokeStyle = ink.edge;
    context.lineWidth = 1;
    context.setLineDash([4, 6]);
    const [x, y] = this.#pixels(document_.robot.base);
    context.beginPath();
    context.arc(x, y, 0.46 * Math.min(this.canvas.width, this.canvas.height), 0, 2 * Math.PI);
    context.stroke();
    context.setLineDash([]);
    context.fillStyle = ink.label;
    context.font = `${11 * this.view.ratio}px system-ui, sans-serif`;
    context.textAlign = "center";
    context.fillText("the arm's workspace", this.canvas.width / 2, 16 * this.view.ratio);
    context.fillStyle = ink.edge;
    for (const shape of document_.obstacle ?? []) context.fill(this.#outline(shape));
    context.strokeStyle = GOAL;
    context.lineWidth = 3 * fine;
    for (const shape of document_.goal ?? []) if (!shape.joints && !shape.cell && !shape.joints_lower) context.stroke(this.#outline(shape));
    const chosen = this.canvas.matches(":focus-visible") ? this.#things[this.#chosen] : undefined;
    if (chosen) {
      context.setLineDash([6, 4]);
      context.strokeStyle = ARM;
      context.stroke(this.#outline(this.#document[chosen[0]][chosen[1]]));
      context.setLineDash([]);
    }
    const { poses } = this, last = poses.length - 1;
    if (last > 0) {
      const every = Math.max(1, Math.round(last / GHOSTS));
      for (let n = 0; n <= last; n += every) this.#paintArm(poses[n], 0.16, fine);
      context.beginPath();
      poses.forEach((pose, n) => (n ? context.lineTo(...this.#pixels(pose[pose.length - 1])) : context.moveTo(...this.#pixels(pose[pose.length - 1]))));
      context.lineWidth = 2 * fine;
      context.strokeStyle = GOAL;
      context.stroke();
      const steps = last + POSES_A_SECOND, at = Math.min(last, Math.floor((now / 1000) * POSES_A_SECOND) % steps);
      if (!this.hovered) this.#paintArm(poses[at], 1, fine);
    }
    if (this.hovered) this.#paintArm(this.hovered, 1, fine);
  }

  /** @param {Pose} pose @param {number} opacity @param {number} fine */
  #paintArm(pose, opacity, fine) {
    const { context } = this;
    context.globalAlpha = opacity;
    context.strokeStyle = context.fillStyle = ARM;
    context.lineWidth = 6 * fine;
    context.lineCap = context.lineJoin = "round";
    context.beginPath();
    pose.forEach((joint, n) => (n ? context.lineTo(...this.#pixels(joint)) : context.moveTo(...this.#pixels(joint))));
    context.stroke();
    for (const joint of opacity === 1 ? pose : []) {
      context.beginPath();
      context.arc(...this.#pixels(joint), 6 * fine, 0, 2 * Math.PI);
      context.fill();
    }
    context.globalAlpha = 1;
  }

  /** @param {PointerEvent} event */
  #down(event) {
    if (!this.scene || !this.canDraw || event.button !== 0 || this.model.before) return;
    const around = this.canvas.getBoundingClientRect(), ratio = this.canvas.width / around.width;
    const x = (event.clientX - around.left) * ratio, y = (event.clientY - around.top) * ratio;
    for (const list of /** @type {const} */ (["goal", "obstacle"])) {
      const shapes = /** @type {Shape[]} */ (this.#document[list] ?? []);
      this.context.lineWidth = 16;
      const number = shapes.findIndex((shape) => {
        const outline = this.#outline(shape);
        return this.context.isPointInPath(outline, x, y) || this.context.isPointInStroke(outline, x, y);
      });
      if (number < 0) continue;
      this.canvas.setPointerCapture(event.pointerId);
      this.model.begin();
      this.#drag = { list, number, from: this.#place(event), first: this.scene };
      return;
    }
  }

  /** All that can be moved: goals in the workspace, then obstacles. @returns {["goal" | "obstacle", number][]} */
  get #things() {
    const lists = /** @type {const} */ (["goal", "obstacle"]);
    return lists.flatMap((list) => (this.#document[list] ?? []).map((/** @type {Shape} */ _, /** @type {number} */ n) => [list, n]));
  }

  /** Space chooses the next thing, arrows move it. @param {KeyboardEvent} event */
  async #key(event) {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!this.scene || !this.canDraw || (event.key !== " " && !step)) return;
    event.preventDefault();
    if (!step) this.#chosen = (this.#chosen + 1) % this.#things.length;
    const thing = this.#things[this.#chosen];
    if (!step || !thing || this.#drag) return;
    this.model.begin();
    this.#shift(this.scene, ...thing, step.map((part) => (part * KEY_PIXELS) / this.#frame.scale));
    await this.resample();
    this.model.commit();
  }

  /** Move one thing of a scene. @param {Scene} first @param {"goal" | "obstacle"} list @param {number} number @param {number[]} by metres */
  #shift(first, list, number, by) {
    const world = /** @type {any} */ (first.world);
    const shapes = world[list].map((/** @type {Shape} */ shape, /** @type {number} */ n) => (n === number ? moved(shape, by) : shape));
    this.model.show({ .../** @type {Scene} */ (this.model.scene), world: { ...world, [list]: shapes } });
  }

  /** @param {PointerEvent} event */
  #move(event) {
    if (!this.#drag || !this.model.scene) return;
    const { list, number, from, first } = this.#drag, to = this.#place(event);
    this.#shift(first, list, number, [to[0] - from[0], to[1] - from[1]]);
    this.resample();
  }

  async #end() {
    if (!this.#drag) return;
    this.#drag = null;
    await this.resample();
    this.model.commit();
  }
}
