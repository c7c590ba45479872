// A scope: voltages of cells over a logarithmic time axis, with a cursor at the time shown.

import { engineering } from "./circuit.js";
import { inks } from "./pictures.js";
import { Surface } from "./surface.js";

/** @typedef {{name: string, volts: number[]}} Curve
 * @typedef {{times: number[], curves: Curve[], at: number, dark: boolean}} Trace */

/** Margins of the plot in CSS pixels; the slider below has the same ends. */
const LEFT = 52, RIGHT = 16, TOP = 18, BOTTOM = 30;
const COLOURS = [["#1f5fbf", "#7fb2ff"], ["#b3261e", "#ff8f85"]];

export class Scope extends Surface {
  /** @type {Trace | null} */ #trace = null;

  /** @param {Trace} trace */
  show(trace) {
    this.#trace = trace;
    this.resized();
  }

  resized() {
    if (this.#trace) this.#paint(this.#trace);
  }

  /** Transformation from (log10 of time, volts) to pixels. */
  get matrix() {
    const { ratio, canvas: { width, height } } = this, { times, curves } = /** @type {Trace} */ (this.#trace);
    const [low, high] = rangeOf(curves), first = Math.log10(times[0]), last = Math.log10(times[times.length - 1]);
    const w = (width - (LEFT + RIGHT) * ratio) / (last - first), h = (height - (TOP + BOTTOM) * ratio) / (high - low);
    return new DOMMatrix([w, 0, 0, -h, LEFT * ratio - w * first, TOP * ratio + h * high]);
  }

  /** @param {Trace} trace */
  #paint({ times, curves, at, dark }) {
    const { context, ratio, canvas: { width, height } } = this, ink = inks(dark), [low, high] = rangeOf(curves);
    const first = Math.log10(times[0]), last = Math.log10(times[times.length - 1]), now = Math.log10(times[at]);
    context.fillStyle = ink.back;
    context.fillRect(0, 0, width, height);
    this.inUnits(() => context.rect(first, low, last - first, high - low));
    this.stroke(ink.label, ratio);
    for (const volts of [low, (low + high) / 2, high]) {
      const [x, y] = this.toPixels([first, volts]);
      this.write(engineering(volts, "V", 3), x - 5 * ratio, y, ink.label, "right", 10);
    }
    for (let decade = Math.ceil(first - 1e-9); decade <= last; decade++) {
      this.inUnits(() => {
        context.moveTo(decade, low);
        context.lineTo(decade, high);
      });
      this.stroke(ink.label, 0.4 * ratio, [2, 3]);
      const [x, y] = this.toPixels([decade, low]);
      this.write(engineering(10 ** decade, "s", 3), x, y + 9 * ratio, ink.label, "center", 10);
    }
    this.write("time (logarithmic)", width / 2, height - 7 * ratio, ink.label, "center", 10);
    this.inUnits(() => {
      context.moveTo(now, low);
      context.lineTo(now, high);
    });
    this.stroke(ink.text, 1.2 * ratio);
    let x = LEFT * ratio;
    curves.forEach(({ name, volts }, n) => {
      const colour = COLOURS[n][dark ? 1 : 0], isKnown = Number.isFinite(volts[at]);
      this.inUnits(() => volts.forEach((value, m) => context[m ? "lineTo" : "moveTo"](Math.log10(times[m]), value)));
      if (isKnown) this.stroke(colour, 2 * ratio, n ? [6, 3] : []);
      if (isKnown) this.disc([now, volts[at]], 3.5 * ratio);
      if (isKnown) this.fill(colour);
      const text = `${name}: ${isKnown ? engineering(volts[at], "V", 3) : "no node"}`;
      this.write(text, x, 8 * ratio, colour, "left", 11);
      x += context.measureText(text).width + 16 * ratio;
    });
  }
}

/** Return the range of the voltage axis, which includes 0. @param {Curve[]} curves */
function rangeOf(curves) {
  const volts = curves.flatMap((curve) => curve.volts).filter((value) => Number.isFinite(value));
  const low = Math.min(0, ...volts), high = Math.max(0, ...volts), least = 1e-6 * (high - low);
  return high > low ? [low > -least ? 0 : low, high < least ? 0 : high] : [low, low + 1];
}
