// Pictures of one pixel a cell: the field, and what is drawn.

import { NOTHING } from "./frame.js";
import { inks, RAMP } from "./colours.js";

/** @typedef {import("./frame.js").Frame} Frame */
/** @typedef {import("./model.js").Scene} Scene */

/** @param {number} nx @param {number} ny */
function canvasOf(nx, ny) {
  const canvas = document.createElement("canvas");
  canvas.width = nx;
  canvas.height = ny;
  return canvas;
}

/** @param {HTMLCanvasElement | null} canvas @param {number} nx @param {number} ny @param {(pixels: Uint32Array) => void} fill */
function painted(canvas, nx, ny, fill) {
  if (canvas?.width !== nx || canvas.height !== ny) canvas = canvasOf(nx, ny);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const image = context.createImageData(nx, ny);
  fill(new Uint32Array(image.data.buffer));
  context.putImageData(image, 0, 0);
  return canvas;
}

/** The field, light at the goal. @param {HTMLCanvasElement | null} canvas @param {Frame} frame @param {boolean} dark */
export function paintField(canvas, { nx, ny, picture, scale }, dark) {
  const { blank } = inks(dark), isHeight = scale.kind === "height";
  return painted(canvas, nx, ny, (pixels) => {
    for (let i = 0, at = 0; i < nx; i++) {
      for (let j = 0; j < ny; j++, at++) {
        const value = picture[at], share = (isHeight ? NOTHING - 1 - value : value) / (NOTHING - 1);
        pixels[(ny - 1 - j) * nx + i] = value === NOTHING ? blank : RAMP[Math.round(share * 1023)];
      }
    }
  });
}

/** Obstacles, and how costly cells are. @param {HTMLCanvasElement | null} canvas @param {Scene} scene @param {boolean} dark */
export function paintCells(canvas, scene, dark) {
  const [nx, ny] = scene.axes.map((axis) => axis.cells);
  const { wall } = inks(dark);
  const veils = scene.palette.map((value) => veil(value));
  return painted(canvas, nx, ny, (pixels) => {
    for (let i = 0, at = 0; i < nx; i++) {
      for (let j = 0; j < ny; j++, at++) {
        const byte = scene.cells[at];
        pixels[(ny - 1 - j) * nx + i] = byte & 1 ? wall : veils[byte >> 2];
      }
    }
  });
}

/** What lies over a cell of another conductivity: dark where it conducts badly, white where well. @param {number} value */
function veil(value) {
  if (value === 1) return 0;
  const opacity = Math.min(200, Math.round(60 * Math.abs(Math.log10(value)) + 40)) << 24;
  return (value < 1 ? opacity | 0x1f2f5f : opacity | 0xffffff) >>> 0;
}
