// The canvas of the grid: its coordinate transformation, and the painting of each animation frame.

import { paintCircuit, paintSupplies } from "./circuit.js";
import { colours } from "./colours.js";
import { Dots } from "./dots.js";
import { cellOf, sizeOf, spacingOf } from "./model.js";
import { nameOf, tickOf } from "./names.js";
import { inks, paintCells, paintField, traceArrows, traceEquipotentials } from "./pictures.js";
import { Surface } from "./surface.js";

/** @typedef {import("./frame.js").Frame} Frame */
/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {{name: string, scene: Scene, lines: Float32Array[]}} Others comparison paths and their scene */

const MARGIN = 10, LABELS = 22, SUPPLIES = 112;
const START = "#ffffff", CASING = "#10151c";
/** Colour and width of comparison paths. @type {Record<string, [string, number]>} */
const OTHERS = { ideal: ["#ffb199", 1.5], "k = 0": ["#7fd0ff", 2], "k = 1": ["#ffb000", 2] };

export class View extends Surface {
  /** @type {Scene | null} */ scene = null;
  /** @type {Frame | null} */ frame = null;
  /** The frame, or a picture of the transient. @type {Frame | null} */ #moment = null;
  /** Whether a picture of the transient is shown, for which currents are unknown. */ isSettling = false;
  #isStale = false;
  #field = document.createElement("canvas");
  #cells = document.createElement("canvas");
  #lines = document.createElement("canvas");
  /** @type {number[] | null} */ cursor = null;
  /** The cell that is pinned to the scope. @type {number[] | null} */ pinned = null;
  /** @type {number[][] | null} */ rectangle = null;
  /** @type {Others[]} */ others = [];
  shows = { dots: true, equipotentials: true, arrows: false, paths: true, circuit: true, ends: false };
  #dots = new Dots(900);
  #then = 0;

  /** @param {Scene} scene */
  setScene(scene) {
    const old = this.scene, fits = old && sizeOf(old).every((size, a) => size === sizeOf(scene)[a]);
    this.scene = scene;
    if (!fits) this.setFrame(null);
    if (!fits || old.cells !== scene.cells || old.palette !== scene.palette) paintCells(this.#cells, scene, this.dark);
  }

  /** @param {Frame | null} frame */
  setFrame(frame) {
    const [nx, ny] = this.scene ? sizeOf(this.scene) : [];
    if (frame && (frame.nx !== nx || frame.ny !== ny)) return;
    this.frame = frame;
    this.setMoment(null);
  }

  /** Show a picture of the transient, or the frame again.
   * @param {{picture: Uint16Array} | null} moment */
  setMoment(moment) {
    this.isSettling = moment !== null;
    this.#moment = this.frame && { ...this.frame, ...moment };
    this.#isStale = true;
  }

  /** Repaint everything after a change of the theme or of the display options. */
  refresh() {
    if (this.scene) paintCells(this.#cells, this.scene, this.dark);
    this.#isStale = true;
  }

  resized() {
    this.#isStale = true;
  }

  /** The circuit, if it is shown. */
  get circuit() {
    return (this.shows.circuit && this.frame?.circuit) || null;
  }

  /** Transformation from cells to pixels, with the grid in the middle and the names of axes at its sides. */
  get matrix() {
    if (!this.scene) return new DOMMatrix();
    const { scene: { axes }, ratio, canvas: { width, height } } = this, [nx, ny] = sizeOf(this.scene);
    const [hx, hy] = axes[0].unit === axes[1].unit ? axes.map(spacingOf) : [1, 1];
    const rim = MARGIN * ratio, both = rim + LABELS * ratio, aside = this.circuit ? SUPPLIES * ratio : 0;
    const scale = Math.min((width - both - aside) / (nx * hx), (height - both) / (ny * hy)), w = scale * hx, h = scale * hy;
    return new DOMMatrix([w, 0, 0, -h, (width - nx * w + both - aside) / 2 - rim, (height + ny * h - both) / 2 + rim]);
  }

  /** Return a start in cells. @param {number[]} start */
  startPoint(start) {
    const { axes } = /** @type {Scene} */ (this.scene);
    return start.map((value, a) => (value - axes[a].lower) / spacingOf(axes[a]));
  }

  /** Return the position of a goal's handle in cells: the goal cell nearest to its centroid. @param {number[]} goal */
  goalPoint(goal) {
    const cells = goal.map((number) => cellOf(/** @type {Scene} */ (this.scene), number));
    const middle = [0, 1].map((a) => cells.reduce((sum, cell) => sum + cell[a], 0) / cells.length);
    const far = (/** @type {number[]} */ cell) => Math.hypot(cell[0] - middle[0], cell[1] - middle[1]);
    const [i, j] = cells.reduce((best, cell) => (far(cell) < far(best) ? cell : best));
    return [i + 0.5, j + 0.5];
  }

  /** @param {number} now */
  paint(now) {
    const seconds = Math.min(0.05, (now - this.#then) / 1000);
    this.#then = now;
    if (!this.scene) return;
    if (this.#isStale) this.#paintGround();
    const { context, canvas, frame, circuit, scene, shows } = this, [nx, ny] = sizeOf(scene), ink = inks(this.dark);
    context.fillStyle = ink.back;
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.imageSmoothingEnabled = false;
    if (frame) this.inUnits(() => context.drawImage(this.#field, 0, 0, nx, ny));
    context.drawImage(this.#lines, 0, 0);
    this.inUnits(() => context.rect(0, 0, nx, ny));
    if (circuit) this.fill(ink.veil);
    this.inUnits(() => context.drawImage(this.#cells, 0, 0, nx, ny));
    this.#paintRim(ink.edge, ink.label);
    context.save();
    this.inUnits(() => context.rect(0, 0, nx, ny)).clip();
    this.inUnits(() => scene.goals.flat().forEach((number) => context.rect(...cellOf(scene, number), 1, 1)));
    this.fill(colours.goal);
    if (circuit) paintCircuit(this, circuit, ink.text);
    if (frame && shows.arrows && !this.isSettling) this.#paintArrows(frame);
    if (frame && shows.dots && !this.isSettling) this.#paintDots(frame, seconds);
    if (frame && shows.paths) this.#paintPaths(frame);
    this.#paintBroken();
    this.#paintCursor();
    context.restore();
    this.#paintHandles();
    if (circuit) paintSupplies(this, circuit, ink, { goal: colours.goal, start: CASING });
  }

  /** Paint the field aside, and its equipotentials at the canvas' own resolution: once a repaint at most, while the next
   * field is already asked for. */
  #paintGround() {
    const lines = this.#lines, moment = this.#moment;
    lines.width = this.canvas.width;
    lines.height = this.canvas.height;
    this.#isStale = false;
    if (!moment) return;
    paintField(this.#field, moment, this.dark);
    if (!this.shows.equipotentials) return;
    const context = /** @type {CanvasRenderingContext2D} */ (lines.getContext("2d"));
    this.inUnits(() => traceEquipotentials(context, moment), context);
    this.stroke("rgb(8 12 20 / 45%)", Math.max(1, lines.width / 900), [], context);
  }

  /** The border, thick where it is an obstacle and dashed where it is a seam; names, units and ends of both axes.
   * @param {string} colour @param {string} label */
  #paintRim(colour, label) {
    const { context, ratio } = this, scene = /** @type {Scene} */ (this.scene), size = sizeOf(scene);
    const [left, bottom] = this.toPixels([0, 0]), [right, top] = this.toPixels(size);
    scene.axes.forEach(({ name, unit, lower, upper, periodic }, a) => {
      this.inUnits(() => {
        for (const end of [0, size[a]]) {
          context.moveTo(a ? 0 : end, a ? end : 0);
          context.lineTo(a ? size[0] : end, a ? end : size[1]);
        }
      });
      this.stroke(colour, !periodic && scene.edge[a] === "obstacle" ? 4 : 1.5, periodic ? [6, 6] : []);
      context.save();
      context.translate(left - (a ? 12 * ratio : 0), bottom + (a ? 0 : 12 * ratio));
      if (a) context.rotate(-Math.PI / 2);
      const length = a ? bottom - top : right - left;
      const called = nameOf(scene.axes[a]);
      this.write(tickOf(lower, scene.axes[a]), 0, 0, label, "left");
      this.write(tickOf(upper, scene.axes[a]), length, 0, label, "right");
      this.write(unit && unit !== name ? `${called} (${unit})` : called, length / 2, 0, label);
      context.restore();
    });
  }

  /** @param {Frame} frame @param {number} seconds */
  #paintDots(frame, seconds) {
    const dots = this.#dots, { a: w, d: h } = this.matrix, size = Math.max(2, this.canvas.width / 380);
    dots.move(frame, (this.scene?.axes ?? []).map((axis) => axis.periodic), seconds);
    this.context.fillStyle = "rgb(255 255 255 / 80%)";
    this.inUnits((context) => {
      for (let n = 0; n < dots.count; n++) if (dots.x[n] >= 0) context.fillRect(dots.x[n], dots.y[n], size / w, size / h);
    });
  }

  /** @param {Frame} frame */
  #paintArrows(frame) {
    this.inUnits((context) => traceArrows(context, frame));
    this.stroke("rgb(16 21 28 / 85%)", Math.max(1, this.canvas.width / 900));
  }

  /** Paint certified paths as solid lines, previews as dashed lines, and comparison paths as thin lines. @param {Frame} frame */
  #paintPaths(frame) {
    const scale = this.canvas.width / 900, fine = Math.max(0.8, scale), dash = frame.exact ? [] : [8 * scale, 6 * scale];
    this.context.lineJoin = this.context.lineCap = "round";
    for (const { name, lines } of this.others) {
      const [colour, width] = OTHERS[name];
      for (const line of lines) this.#paintLine(line, [[CASING, (width + 1.5) * scale], [colour, width * scale]]);
    }
    for (const line of frame.lines) this.#paintLine(line, [[CASING, 6 * fine], [START, 3 * fine]], dash);
  }

  /** Trace a line and its periodic images. @param {Float32Array} line @param {[string, number][]} strokes @param {number[]} [dash] */
  #paintLine(line, strokes, dash) {
    const [turns, others] = /** @type {Scene} */ (this.scene).axes.map(({ periodic, cells }) => (periodic ? [-cells, 0, cells] : [0]));
    this.inUnits((context) => {
      for (const p of turns) {
        for (const q of others) {
          for (let n = 0; n < line.length; n += 2) context[n ? "lineTo" : "moveTo"](line[n] + p, line[n + 1] + q);
        }
      }
    });
    for (const [colour, width] of strokes) this.stroke(colour, Math.max(1.5, width), dash);
  }

  /** Paint crosses on the faces of open resistors. */
  #paintBroken() {
    const { a: w, d: h } = this.matrix, dx = Math.max(5 / w, 0.35), dy = Math.max(-5 / h, 0.35);
    this.inUnits((context) => {
      for (const [i, j, axis] of this.scene?.broken ?? []) {
        const x = axis ? i + 0.5 : i, y = axis ? j : j + 0.5;
        for (const side of [dy, -dy]) {
          context.moveTo(x - dx, y - side);
          context.lineTo(x + dx, y + side);
        }
      }
    });
    this.stroke("#ff3b30", Math.max(2.5, this.canvas.width / 400));
  }

  #paintCursor() {
    this.inUnits((context) => {
      if (this.rectangle) {
        const [one, other] = this.rectangle, [i, j] = one.map((part, a) => Math.min(part, other[a]));
        context.rect(i, j, Math.abs(one[0] - other[0]) + 1, Math.abs(one[1] - other[1]) + 1);
      }
      if (this.cursor && this.canvas.matches(":focus")) context.rect(this.cursor[0], this.cursor[1], 1, 1);
    });
    this.stroke(START, 2);
    if (!this.pinned) return;
    const [i, j] = this.pinned;
    this.disc([i + 0.5, j + 0.5], 7 * this.ratio);
    this.stroke(CASING, 5 * this.ratio);
    this.stroke(START, 2.5 * this.ratio);
  }

  #paintHandles() {
    const { ratio } = this, { goals, starts } = /** @type {Scene} */ (this.scene);
    for (const point of goals.map((goal) => this.goalPoint(goal))) {
      this.#paintHandle(point, colours.goal, 9 * ratio, CASING);
      this.#paintHandle(point, START, 3.6 * ratio, colours.goal);
    }
    starts.forEach((start, number) => {
      const point = this.startPoint(start);
      this.#paintHandle(point, START, 8 * ratio, CASING);
      if (starts.length > 1) this.write(String(number + 1), ...this.toPixels(point), CASING);
    });
  }

  /** @param {number[]} point @param {string} colour @param {number} radius @param {string} rim */
  #paintHandle(point, colour, radius, rim) {
    this.disc(point, radius);
    this.fill(colour);
    this.stroke(rim, 2);
  }
}
