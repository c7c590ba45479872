// Frames: solutions of a drawing, as received from the server.

/**
 * @typedef {{outcome: string | null, points: number, goal?: number, cells?: number, length?: number,
 *   clearance?: number | null, message?: string}} Path
 * @typedef {{resistors: number[][], supplies: {rail: string, volts: number, amperes: number}[], fed: number | null, leak: number | null,
 *   segments?: number[][], contacts?: number[][], nodes?: number[][]}} Circuit
 *   segments: resistors of other lattices than square, with x and y of both ends in cells, ohms, volts, and amperes from the first
 *   end; contacts: x and y of nodes with contacts to the obstacle rail, and their ohms; nodes: x and y of all free nodes;
 *   leak: median resistance of the leaks of the nodes, in ohms; resistors: axis, i, j, ohms, volts and amperes upwards, across the lower face of cell (i, j)
 * @typedef {object} Frame
 * @property {boolean} exact
 * @property {Path[]} paths
 * @property {Float32Array[]} lines points x, y, x, y ... of every path, in cells
 * @property {Uint16Array} picture
 * @property {{kind: "decades" | "height", low: number, high: number}} scale
 * @property {Int8Array} currents of every cell through the lower and upper face across each axis
 * @property {Uint8Array} speed
 * @property {number} nx
 * @property {number} ny
 * @property {number} seconds
 * @property {string[]} methods
 * @property {number} cut_off
 * @property {string[]} flat
 * @property {Circuit | null} [circuit] for small grids
 * @property {number[][][][]} poses of the arm along every path
 */

export const NOTHING = 65535;

/** Return the lines in a body. @param {Uint8Array} body @param {number[]} counts number of points of each line */
export function readLines({ buffer, byteOffset }, counts) {
  let at = byteOffset;
  return counts.map((points) => {
    const line = new Float32Array(buffer, at, 2 * points);
    at += 8 * points;
    return line;
  });
}

/** @param {any} head @param {Uint8Array} body @param {number[]} size @returns {Frame} */
export function readFrame(head, body, [nx, ny]) {
  const lines = readLines(body, head.paths.map((/** @type {Path} */ path) => path.points)), { buffer } = body, cells = nx * ny;
  const at = lines.reduce((end, line) => end + line.byteLength, body.byteOffset);
  const picture = new Uint16Array(buffer, at, cells), currents = new Int8Array(buffer, at + 2 * cells, 4 * cells);
  return { ...head, lines, picture, currents, speed: new Uint8Array(buffer, at + 6 * cells, cells), nx, ny };
}
