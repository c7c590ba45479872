// The canvas: where cells lie on it, and everything that is drawn there sixty times a second.

import { paintCircuit, paintSupplies } from "./circuit.js";
import { Dots } from "./dots.js";
import { cellOf, sizeOf, spacingOf } from "./model.js";
import { inks, paintCells, paintField, traceEquipotentials } from "./pictures.js";

/** @typedef {import("./frame.js").Frame} Frame */
/** @typedef {import("./model.js").Scene} Scene */

const MARGIN = 10, LABELS = 22, SUPPLIES = 112;
const START = "#ffffff", CASING = "#10151c", ENDS = ["#7fd0ff", "#ffb000"];
export const GOAL = "#ff5d3b";

/** Pixels of a canvas for each of the page. */
export const pixelRatio = () => Math.min(2, window.devicePixelRatio || 1);

/** Give a canvas as many pixels as it has room for, now and whenever that changes.
 * @param {HTMLCanvasElement} canvas @param {() => void} [then] */
export function keepSharp(canvas, then) {
  new ResizeObserver(() => {
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * pixelRatio()));
    canvas.height = Math.max(1, Math.round(canvas.clientHeight * pixelRatio()));
    then?.();
  }).observe(canvas);
}

/** The pixel of a canvas under the pointer. @param {HTMLCanvasElement} canvas @param {{clientX: number, clientY: number}} event */
export function pixelUnder(canvas, { clientX, clientY }) {
  const { left, top, width } = canvas.getBoundingClientRect(), ratio = canvas.width / width;
  return [(clientX - left) * ratio, (clientY - top) * ratio];
}

export class View {
  /** @type {Scene | null} */ scene = null;
  /** @type {Frame | null} */ frame = null;
  /** The frame, or a moment before it was reached. @type {Frame | null} */ #moment = null;
  #isStale = false;
  #field = document.createElement("canvas");
  #cells = document.createElement("canvas");
  #lines = document.createElement("canvas");
  /** @type {number[] | null} */ cursor = null;
  /** @type {number[][] | null} */ rectangle = null;
  /** Paths of the chip without flaws, where this one has some. @type {Float32Array[]} */ ideal = [];
  /** Paths of k = 0 and of k = 1. @type {Float32Array[][]} */ ends = [];
  shows = { dots: true, equipotentials: true, arrows: false, paths: true, circuit: true, ends: false };
  dark = false;
  #dots = new Dots(900);
  #then = 0;

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { alpha: false }));
    keepSharp(canvas, () => { this.#isStale = true; });
  }

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

  /** Show another picture in place of the frame's, or the frame's again. @param {{picture: Uint16Array, scale: any} | null} moment */
  setMoment(moment) {
    this.#moment = this.frame && { ...this.frame, ...moment };
    this.#isStale = true;
  }

  /** Paint everything anew: another theme, other things shown. */
  refresh() {
    if (this.scene) paintCells(this.#cells, this.scene, this.dark);
    this.setMoment(null);
  }

  /** What is drawn of the circuit. */
  get circuit() {
    return (this.shows.circuit && this.frame?.circuit) || null;
  }

  get ratio() {
    return pixelRatio();
  }

  /** Left, top, width and height of the grid and of a cell, in pixels of the canvas. */
  get box() {
    const { axes } = /** @type {Scene} */ (this.scene), [nx, ny] = axes.map((axis) => axis.cells), { ratio } = this;
    const [hx, hy] = axes[0].unit === axes[1].unit ? axes.map(spacingOf) : [1, 1];
    const { width, height } = this.canvas, rim = MARGIN * ratio, both = rim + LABELS * ratio;
    const aside = this.circuit ? SUPPLIES * ratio : 0;
    const scale = Math.min((width - both - aside) / (nx * hx), (height - both) / (ny * hy));
    const w = scale * hx, h = scale * hy;
    return { x: (width - nx * w + both - aside) / 2 - rim, y: (height - ny * h - both) / 2 + rim, w, h, nx, ny };
  }

  /** Pixels of a point in cells. @param {number[]} point */
  toPixels([a, b]) {
    const { x, y, w, h, ny } = this.box;
    return [x + a * w, y + (ny - b) * h];
  }

  /** A point in cells under the pointer. @param {{clientX: number, clientY: number}} event */
  pointOf(event) {
    const [px, py] = pixelUnder(this.canvas, event), { x, y, w, h, ny } = this.box;
    return [(px - x) / w, ny - (py - y) / h];
  }

  /** A start in cells. @param {number[]} start */
  startPoint(start) {
    const { axes } = /** @type {Scene} */ (this.scene);
    return start.map((value, a) => (value - axes[a].lower) / spacingOf(axes[a]));
  }

  /** Where the handle of a goal is, in cells: the cell nearest to its middle. @param {number[]} goal */
  goalPoint(goal) {
    const cells = goal.map((number) => cellOf(/** @type {Scene} */ (this.scene), number));
    const middle = [0, 1].map((a) => cells.reduce((sum, cell) => sum + cell[a], 0) / cells.length);
    const far = (/** @type {number[]} */ cell) => Math.hypot(cell[0] - middle[0], cell[1] - middle[1]);
    const [i, j] = cells.reduce((best, cell) => (far(cell) < far(best) ? cell : best));
    return [i + 0.5, j + 0.5];
  }

  /** Draw with a context in units of cells: what is traced there is stroked and filled in pixels.
   * @param {(context: CanvasRenderingContext2D) => void} trace @param {CanvasRenderingContext2D} [context] */
  #inCells(trace, context = this.context) {
    const { x, y, w, h, ny } = this.box;
    context.beginPath();
    context.setTransform(w, 0, 0, -h, x, y + ny * h);
    trace(context);
    context.resetTransform();
    return context;
  }

  /** @param {CanvasRenderingContext2D} context @param {string} colour @param {number} width */
  #stroke(context, colour, width) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke();
  }

  /** @param {number} now */
  paint(now) {
    const seconds = Math.min(0.05, (now - this.#then) / 1000);
    this.#then = now;
    if (!this.scene) return;
    if (this.#isStale) this.#paintGround();
    const { context, canvas, frame, circuit, shows, ratio } = this, { x, y, w, h, nx, ny } = this.box, ink = inks(this.dark);
    context.fillStyle = ink.back;
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.imageSmoothingEnabled = false;
    if (frame) context.drawImage(this.#field, x, y, nx * w, ny * h);
    context.drawImage(this.#lines, 0, 0);
    if (circuit) {
      context.fillStyle = ink.veil;
      context.fillRect(x, y, nx * w, ny * h);
    }
    context.drawImage(this.#cells, x, y, nx * w, ny * h);
    this.#paintRim(ink.edge, ink.label);
    context.save();
    this.#inCells(() => context.rect(0, 0, nx, ny)).clip();
    context.fillStyle = GOAL;
    this.#inCells(() => this.scene?.goals.flat().forEach((number) => context.rect(...this.#corner(number), 1, 1))).fill();
    if (circuit) paintCircuit(this, circuit, ink.text);
    if (frame && shows.arrows) this.#paintArrows(frame);
    if (frame && shows.dots) this.#paintDots(frame, seconds);
    if (frame && shows.paths) this.#paintPaths(frame);
    this.#paintBroken();
    this.#paintCursor();
    context.restore();
    this.#paintHandles();
    if (!circuit) return;
    context.setTransform(ratio, 0, 0, ratio, x + nx * w + 14 * ratio, y + 8 * ratio);
    paintSupplies(context, circuit, ink.text, (rail) => (rail.startsWith("goal") ? GOAL : rail === "start" ? CASING : ink.edge));
    context.resetTransform();
  }

  /** @param {number} number of a cell @returns {[number, number]} */
  #corner(number) {
    return /** @type {[number, number]} */ (cellOf(/** @type {Scene} */ (this.scene), number));
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
    this.#inCells(() => traceEquipotentials(context, moment), context);
    this.#stroke(context, "rgb(8 12 20 / 45%)", Math.max(1, lines.width / 900));
  }

  /** The border, thick where it is an obstacle and dashed where it is a seam; names, units and ends of both axes.
   * @param {string} colour @param {string} label */
  #paintRim(colour, label) {
    const { context, ratio } = this, { x, y, w, h, nx, ny } = this.box, scene = /** @type {Scene} */ (this.scene);
    context.font = `${11 * ratio}px system-ui, sans-serif`;
    context.textBaseline = "middle";
    scene.axes.forEach(({ name, unit, lower, upper, periodic }, a) => {
      const length = a ? ny * h : nx * w;
      this.#inCells(() => {
        for (const end of [0, a ? ny : nx]) {
          context.moveTo(a ? 0 : end, a ? end : 0);
          context.lineTo(a ? nx : end, a ? end : ny);
        }
      });
      context.setLineDash(periodic ? [6, 6] : []);
      this.#stroke(context, colour, !periodic && scene.edge[a] === "obstacle" ? 4 : 1.5);
      context.save();
      context.translate(a ? x - 12 * ratio : x, y + ny * h + (a ? 0 : 12 * ratio));
      if (a) context.rotate(-Math.PI / 2);
      const title = unit && unit !== name ? `${name} (${unit})` : name;
      const texts = [[lower, "left", 0], [upper, "right", length], [title, "center", length / 2]];
      context.fillStyle = label;
      for (const [text, align, at] of /** @type {[number | string, CanvasTextAlign, number][]} */ (texts)) {
        context.textAlign = align;
        context.fillText(String(typeof text === "number" ? Number(text.toPrecision(4)) : text), at, 0);
      }
      context.restore();
    });
    context.setLineDash([]);
  }

  /** @param {Frame} frame @param {number} seconds */
  #paintDots(frame, seconds) {
    const dots = this.#dots, { w, h } = this.box, size = Math.max(2, this.canvas.width / 380);
    dots.move(frame, (this.scene?.axes ?? []).map((axis) => axis.periodic), seconds);
    this.context.fillStyle = "rgb(255 255 255 / 80%)";
    this.#inCells((context) => {
      for (let n = 0; n < dots.count; n++) if (dots.x[n] >= 0) context.fillRect(dots.x[n], dots.y[n], size / w, size / h);
    });
  }

  /** Directions of the current, some thirty across. @param {Frame} frame */
  #paintArrows({ nx, ny, currents, speed }) {
    const every = Math.max(1, Math.ceil(Math.max(nx, ny) / 32));
    this.#inCells((context) => {
      for (let i = every >> 1; i < nx; i += every) {
        for (let j = every >> 1; j < ny; j += every) {
          const cell = i * ny + j, face = 4 * cell;
          if (!speed[cell]) continue;
          const u = currents[face] + currents[face + 1], v = currents[face + 2] + currents[face + 3], size = Math.hypot(u, v) || 1;
          const dx = (0.4 * every * u) / size, dy = (0.4 * every * v) / size, x = i + 0.5 + dx, y = j + 0.5 + dy;
          context.moveTo(x - 2 * dx, y - 2 * dy);
          context.lineTo(x, y);
          for (const side of [0.36, -0.36]) {
            context.moveTo(x, y);
            context.lineTo(x - 0.6 * dx - side * dy, y - 0.6 * dy + side * dx);
          }
        }
      }
    });
    this.#stroke(this.context, "rgb(16 21 28 / 85%)", Math.max(1, this.canvas.width / 900));
  }

  /** Certified paths are whole, others dashed; thin ones are those of the chip without flaws. @param {Frame} frame */
  #paintPaths(frame) {
    const { context } = this, scale = this.canvas.width / 900, fine = Math.max(0.8, scale);
    context.lineJoin = context.lineCap = "round";
    this.ends.forEach((lines, n) => lines.forEach((line) => this.#paintLine(line, [[CASING, 3.5 * scale], [ENDS[n], 2 * scale]])));
    for (const line of this.ideal) this.#paintLine(line, [["#ffb199", 1.5 * scale]]);
    context.setLineDash(frame.exact ? [] : [8 * scale, 6 * scale]);
    for (const line of frame.lines) this.#paintLine(line, [[CASING, 6 * fine], ["#ffffff", 3 * fine]]);
    context.setLineDash([]);
  }

  /** A line, again beyond every seam. @param {Float32Array} line @param {[string, number][]} strokes */
  #paintLine(line, strokes) {
    const turns = (/** @type {number} */ a) => {
      const { periodic, cells } = /** @type {Scene} */ (this.scene).axes[a];
      return periodic ? [-cells, 0, cells] : [0];
    };
    this.#inCells((context) => {
      for (const p of turns(0)) {
        for (const q of turns(1)) {
          for (let n = 0; n < line.length; n += 2) context[n ? "lineTo" : "moveTo"](line[n] + p, line[n + 1] + q);
        }
      }
    });
    for (const [colour, width] of strokes) this.#stroke(this.context, colour, Math.max(1.5, width));
  }

  /** Crosses on the faces whose resistors are broken. */
  #paintBroken() {
    const { w, h } = this.box, [dx, dy] = [Math.max(5 / w, 0.35), Math.max(5 / h, 0.35)];
    this.#inCells((context) => {
      for (const [i, j, axis] of this.scene?.broken ?? []) {
        const x = axis ? i + 0.5 : i, y = axis ? j : j + 0.5;
        for (const side of [dy, -dy]) {
          context.moveTo(x - dx, y - side);
          context.lineTo(x + dx, y + side);
        }
      }
    });
    this.#stroke(this.context, "#ff3b30", Math.max(2.5, this.canvas.width / 400));
  }

  #paintCursor() {
    this.#inCells((context) => {
      if (this.rectangle) {
        const [one, other] = this.rectangle, [i, j] = one.map((part, a) => Math.min(part, other[a]));
        context.rect(i, j, Math.abs(one[0] - other[0]) + 1, Math.abs(one[1] - other[1]) + 1);
      }
      if (this.cursor && this.canvas.matches(":focus")) context.rect(this.cursor[0], this.cursor[1], 1, 1);
    });
    this.#stroke(this.context, "#ffffff", 2);
  }

  #paintHandles() {
    const { context, ratio } = this, { goals, starts } = /** @type {Scene} */ (this.scene);
    for (const goal of goals) {
      this.#paintDisc(this.goalPoint(goal), GOAL, 9 * ratio);
      this.#paintDisc(this.goalPoint(goal), START, 3.6 * ratio, GOAL);
    }
    context.font = `${11 * ratio}px sans-serif`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    starts.forEach((start, number) => {
      const [px, py] = this.#paintDisc(this.startPoint(start), START, 8 * ratio);
      context.fillStyle = CASING;
      if (starts.length > 1) context.fillText(String(number + 1), px, py);
    });
  }

  /** @param {number[]} point @param {string} colour @param {number} radius @param {string} rim */
  #paintDisc(point, colour, radius, rim = CASING) {
    const { context } = this, [px, py] = this.toPixels(point);
    context.beginPath();
    context.arc(px, py, radius, 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.fill();
    this.#stroke(context, rim, 2);
    return [px, py];
  }
}
