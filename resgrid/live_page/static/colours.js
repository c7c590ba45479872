// Colours of heights and goals, equal to those of rg.draw: the server sends them in its first message.

/** @typedef {{height: string[], goal: string}} Table colours of a height from the goal upwards, and of the goal */

const SHADES = 1024;

/** `ramp`: A B G R of every shade, from the goal upwards; `gradient`: the same for a style sheet. */
export const colours = { ramp: new Uint32Array(SHADES), gradient: "none", goal: "red" };

/** @param {Table} table */
export function setColours({ height, goal }) {
  const stops = height.map((stop) => [1, 3, 5].map((at) => parseInt(stop.slice(at, at + 2), 16)));
  colours.ramp = Uint32Array.from({ length: SHADES }, (_, n) => {
    const at = (n / (SHADES - 1)) * (stops.length - 1), low = Math.min(stops.length - 2, Math.floor(at));
    const [r, g, b] = stops[low].map((value, c) => Math.round(value + (at - low) * (stops[low + 1][c] - value)));
    return (255 << 24) | (b << 16) | (g << 8) | r;
  });
  colours.gradient = `linear-gradient(to right, ${height.join(", ")})`;
  colours.goal = goal;
}
