// Colours: viridis, which colour-blind people and grey printers read, light where the goal is near.

const STOPS = [
  [68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142],
  [31, 158, 137], [53, 183, 121], [110, 206, 88], [181, 222, 43], [253, 231, 37],
];

/** 1024 colours, as 32 bits each: A B G R. */
export const RAMP = Uint32Array.from({ length: 1024 }, (_, n) => {
  const at = (n / 1023) * (STOPS.length - 1), low = Math.min(STOPS.length - 2, Math.floor(at));
  const [r, g, b] = STOPS[low].map((value, c) => Math.round(value + (at - low) * (STOPS[low + 1][c] - value)));
  return (255 << 24) | (b << 16) | (g << 8) | r;
});

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
