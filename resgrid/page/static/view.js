// The canvas: where cells lie on it, and everything that is drawn there sixty times a second.

import { paintCircuit, paintSupplies } from "./circuit.js";
import { inks, RAMP } from "./colours.js";
import { contours } from "./contours.js";
import { Dots } from "./dots.js";
import { cellOf, numberOf, spacingOf } from "./model.js";
import { paintCells, paintField } from "./pictures.js";
import { paintAxes, paintEdge } from "./rim.js";

/** @typedef {import("./frame.js").Frame} Frame */
/** @typedef {import("./model.js").Scene} Scene */

const MARGIN = 10, LABELS = 22, SUPPLIES = 112;
const GOAL = "#ff5d3b", START = "#ffffff", CASING = "#10151c", ENDS = ["#7fd0ff", "#ffb000"];

export class View {
  /** @type {Scene | null} */ scene = null;
  /** @type {Frame | null} */ frame = null;
  /** @type {HTMLCanvasElement | null} */ #field = null;
  /** @type {Frame | null} a moment before the frame was reached */ #moment = null;
  /** @type {HTMLCanvasElement | null} */ #cells = null;
  /** @type {HTMLCanvasElement} */ #lines = document.createElement("canvas");
  /** @type {number[] | null} */ cursor = null;
  /** @type {number[][] | null} */ rectangle = null;
  /** Paths of the chip without flaws, where this one has some. @type {Float32Array[]} */ ideal = [];
  /** Paths of k = 0 and of k = 1. @type {Float32Array[][]} */ ends = [];
  shows = { dots: true, equipotentials: true, arrows: false, paths: true, circuit: true, ends: false };
  dark = false;
  isClosed = false;
  repaints = 0;
  #dots = new Dots(900);
  #then = 0;

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { alpha: false }));
    new ResizeObserver(() => this.#resize()).observe(canvas);
    const loop = (/** @type {number} */ now) => {
      if (this.isClosed) return;
      this.#paint(now);
      requestAnimationFrame(loop);
    };
    requestAnimationFrame(loop);
  }

  /** @param {Scene} scene */
  setScene(scene) {
    const old = this.scene;
    this.scene = scene;
    const fits = old && old.axes.every((axis, a) => axis.cells === scene.axes[a].cells);
    if (!fits) this.frame = this.#field = null;
    if (!fits || old.cells !== scene.cells || old.palette !== scene.palette) {
      this.#cells = paintCells(this.#cells, scene, this.dark);
    }
  }

  /** @param {Frame} frame */
  setFrame(frame) {
    const [nx, ny] = this.scene?.axes.map((axis) => axis.cells) ?? [];
    if (frame.nx !== nx || frame.ny !== ny) return;
    this.frame = frame;
    this.#moment = null;
    this.#field = paintField(this.#field, frame, this.dark);
    this.#paintLines();
  }

  /** Show another picture in place of the frame's, or the frame's again. @param {{picture: Uint16Array, scale: any} | null} moment */
  setMoment(moment) {
    if (!this.frame) return;
    this.#moment = moment ? { ...this.frame, ...moment } : null;
    this.#field = paintField(this.#field, this.#moment ?? this.frame, this.dark);
    this.#paintLines();
  }

  /** Draw the equipotentials of the frame aside, at the canvas' own resolution. */
  #paintLines() {
    const lines = this.#lines, context = /** @type {CanvasRenderingContext2D} */ (lines.getContext("2d"));
    if (lines.width !== this.canvas.width || lines.height !== this.canvas.height) {
      lines.width = this.canvas.width;
      lines.height = this.canvas.height;
    } else {
      context.clearRect(0, 0, lines.width, lines.height);
    }
    if (!this.frame || !this.shows.equipotentials) return;
    const { x, y, w, h, ny } = this.box, segments = contours(this.#moment ?? this.frame);
    context.beginPath();
    for (let n = 0; n < segments.length; n += 4) {
      context.moveTo(x + segments[n] * w, y + (ny - segments[n + 1]) * h);
      context.lineTo(x + segments[n + 2] * w, y + (ny - segments[n + 3]) * h);
    }
    context.strokeStyle = "rgb(8 12 20 / 45%)";
    context.lineWidth = Math.max(1, lines.width / 900);
    context.stroke();
  }

  /** Paint everything anew: another theme, other things shown. */
  refresh() {
    if (this.scene) this.#cells = paintCells(this.#cells, this.scene, this.dark);
    if (this.frame) this.setFrame(this.frame);
  }

  #resize() {
    const { clientWidth, clientHeight } = this.canvas, { ratio } = this;
    this.canvas.width = Math.max(1, Math.round(clientWidth * ratio));
    this.canvas.height = Math.max(1, Math.round(clientHeight * ratio));
    if (this.scene) this.#paintLines();
  }

  /** Pixels of the canvas for each of the page. */
  get ratio() {
    return Math.min(2, window.devicePixelRatio || 1);
  }

  /** What is drawn of the circuit. */
  get circuit() {
    return (this.shows.circuit && this.frame?.circuit) || null;
  }

  /** Left, top, width and height of the grid and of a cell, in pixels of the canvas. */
  get box() {
    const scene = /** @type {Scene} */ (this.scene);
    const [nx, ny] = scene.axes.map((axis) => axis.cells);
    const [hx, hy] = scene.axes[0].unit === scene.axes[1].unit ? scene.axes.map(spacingOf) : [1, 1];
    const { width, height } = this.canvas;
    const rim = MARGIN * this.ratio, both = rim + LABELS * this.ratio;
    const aside = this.circuit ? SUPPLIES * this.ratio : 0;
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
    const around = this.canvas.getBoundingClientRect(), { x, y, w, h, ny } = this.box;
    const ratio = this.canvas.width / around.width;
    return [((event.clientX - around.left) * ratio - x) / w, ny - ((event.clientY - around.top) * ratio - y) / h];
  }

  /** A start in cells. @param {number[]} start */
  startPoint(start) {
    const scene = /** @type {Scene} */ (this.scene);
    return start.map((value, a) => (value - scene.axes[a].lower) / spacingOf(scene.axes[a]));
  }

  /** Where the handle of a goal is, in cells: the cell nearest to its middle. @param {number[]} goal */
  goalPoint(goal) {
    const cells = goal.map((number) => cellOf(/** @type {Scene} */ (this.scene), number));
    const middle = [0, 1].map((a) => cells.reduce((sum, cell) => sum + cell[a], 0) / cells.length);
    const far = (/** @type {number[]} */ cell) => Math.hypot(cell[0] - middle[0], cell[1] - middle[1]);
    const [i, j] = cells.reduce((best, cell) => (far(cell) < far(best) ? cell : best));
    return [i + 0.5, j + 0.5];
  }

  /** @param {number} now */
  #paint(now) {
    const seconds = Math.min(0.05, (now - this.#then) / 1000);
    this.#then = now;
    if (!this.scene) return;
    this.repaints++;
    const { context } = this, { x, y, w, h, nx, ny } = this.box, ink = inks(this.dark);
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = ink.back;
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    context.imageSmoothingEnabled = false;
    if (this.#field) context.drawImage(this.#field, x, y, nx * w, ny * h);
    if (this.frame && this.shows.equipotentials) context.drawImage(this.#lines, 0, 0);
    if (this.circuit) {
      context.fillStyle = ink.veil;
      context.fillRect(x, y, nx * w, ny * h);
    }
    if (this.#cells) context.drawImage(this.#cells, x, y, nx * w, ny * h);
    paintEdge(context, this.scene, this.box, ink.edge);
    paintAxes(context, this.scene, this.box, this.ratio, ink.label);
    context.save();
    context.beginPath();
    context.rect(x, y, nx * w, ny * h);
    context.clip();
    this.#paintGoals();
    if (this.circuit) this.#paintCircuit(this.circuit, ink.text);
    if (this.frame) {
      if (this.shows.arrows) this.#paintArrows(this.frame);
      if (this.shows.dots) this.#paintDots(this.frame, seconds);
      if (this.shows.paths) this.#paintPaths(this.frame);
    }
    this.#paintBroken();
    this.#paintCursor();
    context.restore();
    this.#paintHandles();
    const colour = (/** @type {string} */ rail) => (rail.startsWith("goal") ? GOAL : rail === "start" ? CASING : ink.edge);
    if (this.circuit) paintSupplies(context, this.circuit, x + nx * w + 14 * this.ratio, y + 8 * this.ratio, this.ratio, ink.text, colour);
  }

  /** @param {import("./frame.js").Circuit} circuit @param {string} ink */
  #paintCircuit(circuit, ink) {
    const scene = /** @type {Scene} */ (this.scene), { w, h, nx, ny } = this.box;
    const goals = new Set(scene.goals.flat());
    const isWall = (/** @type {number[]} */ cell) => Boolean(scene.cells[numberOf(scene, cell)] & 1);
    const isRail = (/** @type {number[]} */ cell) => isWall(cell) || goals.has(numberOf(scene, cell));
    paintCircuit(this.context, circuit, (point) => this.toPixels(point), Math.min(w, h), {
      size: [nx, ny], periodic: scene.axes.map((axis) => axis.periodic), isRail, isFree: (cell) => !isRail(cell),
      ratio: this.ratio, ink,
    });
  }

  #paintGoals() {
    const { context } = this, scene = /** @type {Scene} */ (this.scene);
    context.fillStyle = GOAL;
    for (const goal of scene.goals) {
      for (const number of goal) {
        const [i, j] = cellOf(scene, number);
        const [left, top] = this.toPixels([i, j + 1]).map(Math.round), [right, bottom] = this.toPixels([i + 1, j]).map(Math.round);
        context.fillRect(left, top, Math.max(1, right - left), Math.max(1, bottom - top));
      }
    }
  }

  /** @param {Frame} frame @param {number} seconds */
  #paintDots(frame, seconds) {
    const { context } = this, { x, y, w, h, ny } = this.box, dots = this.#dots;
    dots.move(frame, (this.scene?.axes ?? []).map((axis) => axis.periodic), seconds);
    const tail = 0.05 * (Math.max(frame.nx, frame.ny) / 7);
    context.strokeStyle = "rgb(255 255 255 / 75%)";
    context.lineWidth = Math.max(1.6, this.canvas.width / 640);
    context.lineCap = "round";
    context.beginPath();
    for (let n = 0; n < dots.count; n++) {
      if (dots.x[n] < 0) continue;
      const px = x + dots.x[n] * w, py = y + (ny - dots.y[n]) * h;
      context.moveTo(px - dots.u[n] * tail * w, py + dots.v[n] * tail * h);
      context.lineTo(px, py);
    }
    context.stroke();
  }

  /** Directions of the current, some thirty across. @param {Frame} frame */
  #paintArrows({ nx, ny, currents, speed }) {
    const { context } = this, every = Math.max(1, Math.ceil(Math.max(nx, ny) / 32)), { w } = this.box;
    context.strokeStyle = "rgb(16 21 28 / 85%)";
    context.lineWidth = Math.max(1, this.canvas.width / 900);
    context.beginPath();
    for (let i = every >> 1; i < nx; i += every) {
      for (let j = every >> 1; j < ny; j += every) {
        const cell = i * ny + j, face = 4 * cell;
        if (!speed[cell]) continue;
        const u = currents[face] + currents[face + 1], v = currents[face + 2] + currents[face + 3];
        const size = Math.hypot(u, v) || 1, long = 0.4 * every;
        const [tipX, tipY] = this.toPixels([i + 0.5 + (long * u) / size, j + 0.5 + (long * v) / size]);
        const [endX, endY] = this.toPixels([i + 0.5 - (long * u) / size, j + 0.5 - (long * v) / size]);
        const angle = Math.atan2(tipY - endY, tipX - endX), head = 0.28 * every * w;
        context.moveTo(endX, endY);
        context.lineTo(tipX, tipY);
        for (const side of [2.6, -2.6]) {
          context.moveTo(tipX, tipY);
          context.lineTo(tipX + head * Math.cos(angle + side), tipY + head * Math.sin(angle + side));
        }
      }
    }
    context.stroke();
  }

  /** Certified paths are whole, others dashed; thin ones are those of the chip without flaws. @param {Frame} frame */
  #paintPaths(frame) {
    const { context } = this, scale = this.canvas.width / 900;
    context.lineJoin = context.lineCap = "round";
    this.ends.forEach((lines, n) => lines.forEach((line) => this.#paintLine(line, [[CASING, 3.5 * scale], [ENDS[n], 2 * scale]])));
    for (const line of this.ideal) this.#paintLine(line, [["#ffb199", 1.5 * scale]]);
    context.setLineDash(frame.exact ? [] : [8 * scale, 6 * scale]);
    const fine = Math.max(0.8, scale);
    for (const line of frame.lines) this.#paintLine(line, [[CASING, 6 * fine], ["#ffffff", 3 * fine]]);
    context.setLineDash([]);
  }

  /** @param {Float32Array} line @param {[string, number][]} strokes */
  #paintLine(line, strokes) {
    if (line.length < 4) return;
    const { context } = this, { nx, ny } = this.box, route = new Path2D();
    const turns = (/** @type {number} */ a) => (this.scene?.axes[a].periodic ? [-1, 0, 1] : [0]);
    for (const p of turns(0)) {
      for (const q of turns(1)) {
        for (let n = 0; n < line.length; n += 2) {
          const [px, py] = this.toPixels([line[n] + p * nx, line[n + 1] + q * ny]);
          if (n) route.lineTo(px, py);
          else route.moveTo(px, py);
        }
      }
    }
    for (const [colour, width] of strokes) {
      context.strokeStyle = colour;
      context.lineWidth = Math.max(1.5, width);
      context.stroke(route);
    }
  }

  /** Crosses on the faces whose resistors are broken. */
  #paintBroken() {
    const { context } = this, size = Math.max(5, 0.35 * this.box.w);
    context.strokeStyle = "#ff3b30";
    context.lineWidth = Math.max(2.5, this.canvas.width / 400);
    context.beginPath();
    for (const [i, j, axis] of this.scene?.broken ?? []) {
      const [x, y] = this.toPixels(axis === 0 ? [i, j + 0.5] : [i + 0.5, j]);
      for (const side of [1, -1]) {
        context.moveTo(x - size, y - side * size);
        context.lineTo(x + size, y + side * size);
      }
    }
    context.stroke();
  }

  #paintCursor() {
    const { context } = this, { w, h } = this.box;
    context.strokeStyle = "#ffffff";
    context.lineWidth = 2;
    if (this.rectangle) {
      const [one, other] = this.rectangle;
      const low = one.map((part, a) => Math.min(part, other[a])), high = one.map((part, a) => Math.max(part, other[a]) + 1);
      const [left, top] = this.toPixels([low[0], high[1]]);
      context.strokeRect(left, top, (high[0] - low[0]) * w, (high[1] - low[1]) * h);
    }
    if (this.cursor && this.canvas.matches(":focus")) {
      const [left, top] = this.toPixels([this.cursor[0], this.cursor[1] + 1]);
      context.strokeRect(left - 2, top - 2, w + 4, h + 4);
    }
  }

  #paintHandles() {
    const { context } = this, scene = /** @type {Scene} */ (this.scene), { ratio } = this;
    scene.goals.forEach((goal) => this.#paintHandle(this.goalPoint(goal), GOAL, 9 * ratio, "flag"));
    scene.starts.forEach((start, number) => {
      const [px, py] = this.#paintHandle(this.startPoint(start), START, 8 * ratio, "");
      if (scene.starts.length < 2) return;
      context.fillStyle = CASING;
      context.font = `${11 * ratio}px sans-serif`;
      context.textAlign = "center";
      context.textBaseline = "middle";
      context.fillText(String(number + 1), px, py);
    });
  }

  /** @param {number[]} point @param {string} colour @param {number} radius @param {string} mark */
  #paintHandle(point, colour, radius, mark) {
    const { context } = this, [px, py] = this.toPixels(point);
    context.beginPath();
    context.arc(px, py, radius, 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.fill();
    context.lineWidth = 2;
    context.strokeStyle = CASING;
    context.stroke();
    if (mark) {
      context.beginPath();
      context.arc(px, py, radius * 0.4, 0, 2 * Math.PI);
      context.fillStyle = "#ffffff";
      context.fill();
    }
    return [px, py];
  }
}

/** The legend's bar. @param {HTMLCanvasElement} canvas */
export function paintBar(canvas) {
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const image = context.createImageData(canvas.width, 1), pixels = new Uint32Array(image.data.buffer);
  for (let n = 0; n < canvas.width; n++) pixels[n] = RAMP[1023 - Math.round((n / (canvas.width - 1)) * 1023)];
  for (let row = 0; row < canvas.height; row++) context.putImageData(image, 0, row);
}
