// Scales of the panel's sliders: values of k, of the wall resistance and of the leak by slider position.

import { spacingOf } from "./model.js";

/** @typedef {import("./model.js").Scene} Scene */

export const WALL_STEPS = 60, LEAK_STEPS = 60;
/** Longest screening length of the slider, as a multiple of the longest side of the grid. */
const LONGEST = 2;

/** Return k for a slider position, with fine steps near 1, where the Dirichlet field has its effect. @param {number} t */
export const kOf = (t) => Number((1 - (1 - t / 1000) ** 4).toPrecision(6));
/** Return the slider position of k. @param {number} k */
export const kSlider = (k) => Math.round(1000 * (1 - (1 - k) ** 0.25));

/** Return the resistance between neighbours, in ohms. @param {Scene} scene */
export const ohmsOf = ({ chip }) => /** @type {any} */ (chip).resistance ?? 1e4;
/** Return the wall resistance for a slider position, on a logarithmic scale around the grid's resistance. @param {number} t @param {number} ohms */
export const wallOf = (t, ohms) => (t ? Number((ohms * 10 ** (-3 + (6 * (t - 1)) / (WALL_STEPS - 1))).toPrecision(4)) : 0);
/** @param {number} wall @param {number} ohms */
export const wallSlider = (wall, ohms) => (wall ? within(WALL_STEPS, 1 + ((Math.log10(wall / ohms) + 3) / 6) * (WALL_STEPS - 1)) : 0);

/** Return the ends of the scale of screening lengths in axis units: twice the grid's longest side, and one cell. @param {Scene} scene */
const lengthsOf = ({ axes }) => [LONGEST * Math.max(...axes.map(({ lower, upper }) => upper - lower)), Math.min(...axes.map(spacingOf))];

/** Return the leak for a slider position: 0 without a leak, then by screening length, on a logarithmic scale. @param {number} t @param {Scene} scene */
export function leakOf(t, scene) {
  const [longest, shortest] = lengthsOf(scene), length = longest * (shortest / longest) ** ((t - 1) / (LEAK_STEPS - 1));
  return t ? Number((1 / length ** 2).toPrecision(3)) : 0;
}

/** @param {Scene} scene */
export function leakSlider(scene) {
  const [longest, shortest] = lengthsOf(scene), { leak = 0 } = scene;
  return leak ? within(LEAK_STEPS, 1 + ((LEAK_STEPS - 1) * Math.log(longest * Math.sqrt(leak))) / Math.log(longest / shortest)) : 0;
}

/** Return the resistance of the leak of a node, in ohms: R / (leak h^2), with the smallest cell width h. @param {Scene} scene */
export function leakOhms(scene) {
  const [, width] = lengthsOf(scene);
  return ohmsOf(scene) / ((scene.leak ?? 0) * width ** 2);
}

/** Return the nearest position of a slider from 1 to its last one. @param {number} last @param {number} t */
const within = (last, t) => Math.max(1, Math.min(last, Math.round(t)));
