// Pictures with one pixel per cell (field and obstacles), equipotentials, arrows, and the colours of both themes.

import { colours } from "./colours.js";
import { NOTHING } from "./frame.js";
import { sizeOf } from "./model.js";

/** @typedef {import("./frame.js").Frame} Frame */
/** @typedef {import("./model.js").Scene} Scene */

/** Pairs of sides that an equipotential joins, by which corners lie above: sides are bottom, right, top, left. */
const JOINED = [[], [3, 0], [0, 1], [3, 1], [1, 2], [3, 0, 1, 2], [0, 2], [3, 2], [2, 3], [2, 0], [0, 1, 2, 3], [2, 1], [1, 3], [1, 0], [0, 3], []];
const STEPS = [0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500];

/** @param {boolean} dark */
export const inks = (dark) => ({
  back: dark ? "#14171c" : "#f4f5f7",
  blank: dark ? 0xff2b231d : 0xffe6e2de,
  wall: dark ? 0xff0f0b09 : 0xff33291f,
  text: dark ? "#ffffff" : "#10151c",
  veil: dark ? "rgb(20 23 28 / 55%)" : "rgb(244 245 247 / 55%)",
  label: dark ? "#9aa4b2" : "#5b6472",
  edge: dark ? "#5b6575" : "#1f2933",
});

/** Paint one pixel per cell, the second axis downwards. @param {HTMLCanvasElement} canvas @param {number[]} size
 * @param {(cell: number) => number} colourOf a cell's number */
function paint(canvas, [nx, ny], colourOf) {
  if (canvas.width !== nx) canvas.width = nx;
  if (canvas.height !== ny) canvas.height = ny;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d")), image = context.createImageData(nx, ny);
  const pixels = new Uint32Array(image.data.buffer);
  for (let i = 0, at = 0; i < nx; i++) for (let j = 0; j < ny; j++, at++) pixels[j * nx + i] = colourOf(at);
  context.putImageData(image, 0, 0);
}

/** Paint the field. @param {HTMLCanvasElement} canvas @param {Frame} frame @param {boolean} dark */
export function paintField(canvas, { nx, ny, picture, scale }, dark) {
  const { blank } = inks(dark), ramp = scale.kind === "height" ? colours.ramp : colours.ramp.slice().reverse();
  paint(canvas, [nx, ny], (cell) => (picture[cell] === NOTHING ? blank : ramp[picture[cell] >> 6]));
}

/** Paint obstacles and conductivities. @param {HTMLCanvasElement} canvas @param {Scene} scene @param {boolean} dark */
export function paintCells(canvas, scene, dark) {
  const { wall } = inks(dark), veils = scene.palette.map(veil), { cells } = scene;
  paint(canvas, sizeOf(scene), (cell) => (cells[cell] & 1 ? wall : veils[cells[cell] >> 2]));
}

/** Return the overlay colour of a conductivity: dark below 1, white above. @param {number} value */
function veil(value) {
  if (value === 1) return 0;
  const opacity = Math.min(200, Math.round(60 * Math.abs(Math.log10(value)) + 40)) << 24;
  return (value < 1 ? opacity | 0x1f2f5f : opacity | 0xffffff) >>> 0;
}

/** Trace equipotentials in cells, by marching squares between cell centres, except next to cells without a value.
 * @param {CanvasRenderingContext2D} context @param {Frame} frame */
export function traceEquipotentials(context, { nx, ny, picture, scale }) {
  const range = scale.high - scale.low, step = STEPS.find((one) => range / one <= 24) ?? 1000;
  const values = Float32Array.from(picture, (value) => (value === NOTHING ? NaN : (scale.low + (value / (NOTHING - 1)) * range) / step));
  const highest = (scale.high - 1e-3 * range) / step; // at the end of the scale there are plateaus
  for (let i = 0; i + 1 < nx; i++) {
    for (let j = 0; j + 1 < ny; j++) {
      const at = i * ny + j, a = values[at], b = values[at + ny], c = values[at + ny + 1], d = values[at + 1];
      const top = Math.floor(Math.max(a, b, c, d));
      for (let level = Math.floor(Math.min(a, b, c, d)) + 1; level <= top && level < highest; level++) {
        const sides = JOINED[(a >= level ? 1 : 0) | (b >= level ? 2 : 0) | (c >= level ? 4 : 0) | (d >= level ? 8 : 0)];
        const share = (/** @type {number} */ from, /** @type {number} */ to) => (level - from) / (to - from);
        sides.forEach((side, n) => {
          const x = i + 0.5 + [share(a, b), 1, share(d, c), 0][side], y = j + 0.5 + [0, share(b, c), 1, share(a, d)][side];
          if (n % 2) context.lineTo(x, y);
          else context.moveTo(x, y);
        });
      }
    }
  }
}

/** Trace the directions of the current, some thirty arrows across. @param {CanvasRenderingContext2D} context @param {Frame} frame */
export function traceArrows(context, { nx, ny, currents, speed }) {
  const every = Math.max(1, Math.ceil(Math.max(nx, ny) / 32));
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
}
