// Equipotentials, by marching squares between cell centres; none near a cell where nothing is shown.

import { NOTHING } from "./frame.js";

/** @typedef {import("./frame.js").Frame} Frame */

/** Pairs of sides that a line joins, by which corners lie above: sides are bottom, right, top, left. */
const JOINED = [[], [3, 0], [0, 1], [3, 1], [1, 2], [3, 0, 1, 2], [0, 2], [3, 2], [2, 3], [2, 0], [0, 1, 2, 3], [2, 1], [1, 3], [1, 0], [0, 3], []];
const STEPS = [0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500];

/** How many units of the scale lie between two equipotentials. @param {Frame} frame */
export function stepOf({ scale }) {
  const range = scale.high - scale.low;
  return STEPS.find((step) => range / step <= 24) ?? 1000;
}

/** Segments x0, y0, x1, y1 ... in cells. @param {Frame} frame */
export function contours(frame) {
  const { nx, ny, picture, scale } = frame, range = scale.high - scale.low;
  /** @type {number[]} */ const segments = [];
  if (!(range > 0)) return segments;
  const step = stepOf(frame), unit = range / (NOTHING - 1) / step, offset = scale.low / step;
  for (let i = 0; i + 1 < nx; i++) {
    for (let j = 0; j + 1 < ny; j++) {
      const at = i * ny + j;
      const corners = [picture[at], picture[at + ny], picture[at + ny + 1], picture[at + 1]];
      if (corners.includes(NOTHING)) continue;
      const a = corners[0] * unit + offset, b = corners[1] * unit + offset;
      const c = corners[2] * unit + offset, d = corners[3] * unit + offset;
      const top = Math.floor(Math.max(a, b, c, d));
      for (let level = Math.floor(Math.min(a, b, c, d)) + 1; level <= top; level++) {
        const sides = JOINED[(a >= level ? 1 : 0) | (b >= level ? 2 : 0) | (c >= level ? 4 : 0) | (d >= level ? 8 : 0)];
        for (const side of sides) {
          const share = (/** @type {number} */ from, /** @type {number} */ to) => (level - from) / (to - from);
          if (side === 0) segments.push(i + 0.5 + share(a, b), j + 0.5);
          else if (side === 1) segments.push(i + 1.5, j + 0.5 + share(b, c));
          else if (side === 2) segments.push(i + 0.5 + share(d, c), j + 1.5);
          else segments.push(i + 0.5, j + 0.5 + share(a, d));
        }
      }
    }
  }
  return segments;
}
