// Dots that move with the current. Within a cell, the velocity is linear between opposite faces, as for streamlines.
// Dots only illustrate the current; paths are computed by the server.

const LIFE_S = [1.5, 4.5];

/** @typedef {import("./frame.js").Frame} Frame */

export class Dots {
  /** @param {number} count */
  constructor(count) {
    this.count = count;
    this.x = new Float32Array(count);
    this.y = new Float32Array(count);
    this.life = new Float32Array(count);
  }

  /** @param {Frame} frame @param {boolean[]} periodic @param {number} seconds */
  move(frame, periodic, seconds) {
    const pace = Math.max(frame.nx, frame.ny) / 7, steps = Math.max(1, Math.ceil(2 * pace * seconds));
    for (let n = 0; n < this.count; n++) {
      this.life[n] -= seconds;
      let isAlive = this.life[n] > 0;
      for (let s = 0; s < steps && isAlive; s++) isAlive = this.#step(n, frame, periodic, (pace * seconds) / steps);
      if (!isAlive) this.#spawn(n, frame);
    }
  }

  /** @param {number} n @param {Frame} frame @param {boolean[]} periodic @param {number} by */
  #step(n, { nx, ny, currents, speed }, periodic, by) {
    const i = Math.floor(this.x[n]), j = Math.floor(this.y[n]), cell = i * ny + j, face = 4 * cell;
    if (i < 0 || j < 0 || i >= nx || j >= ny || !speed[cell]) return false;
    const a = this.x[n] - i, b = this.y[n] - j, pace = (by * speed[cell]) / (255 * 127);
    this.x[n] = wrapped(this.x[n] + pace * (currents[face] * (1 - a) + currents[face + 1] * a), nx, periodic[0]);
    this.y[n] = wrapped(this.y[n] + pace * (currents[face + 2] * (1 - b) + currents[face + 3] * b), ny, periodic[1]);
    return true;
  }

  /** @param {number} n @param {Frame} frame */
  #spawn(n, { nx, ny, speed }) {
    this.life[n] = LIFE_S[0] + Math.random() * (LIFE_S[1] - LIFE_S[0]);
    for (let attempt = 0; attempt < 8; attempt++) {
      this.x[n] = Math.random() * nx;
      this.y[n] = Math.random() * ny;
      if (speed[Math.floor(this.x[n]) * ny + Math.floor(this.y[n])]) return;
    }
    this.life[n] = 0;
    this.x[n] = -1;
  }
}

/** @param {number} value @param {number} size @param {boolean} periodic */
const wrapped = (value, size, periodic) => (periodic ? ((value % size) + size) % size : value);
