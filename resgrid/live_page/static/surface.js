// A canvas with a coordinate system of its own, such as cells of a grid or metres of a workspace.

/** Return the direction of an arrow key. @param {KeyboardEvent} event @returns {number[] | undefined} */
export const stepOf = (event) => ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] })[event.key];

/** @typedef {{move?: (point: number[]) => void, end?: () => void}} Gesture callbacks of a press, in the canvas' units */

export class Surface {
  dark = false;
  /** @type {Gesture | null} */ #gesture = null;

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d", { alpha: false }));
    new ResizeObserver(() => {
      canvas.width = Math.max(1, Math.round(canvas.clientWidth * this.ratio));
      canvas.height = Math.max(1, Math.round(canvas.clientHeight * this.ratio));
      this.resized();
    }).observe(canvas);
  }

  /** Handle a change of the size of the canvas. */
  resized() {}

  /** Number of canvas pixels per CSS pixel. */
  get ratio() {
    return Math.min(2, window.devicePixelRatio || 1);
  }

  /** Transformation from units to canvas pixels. */
  get matrix() {
    return new DOMMatrix();
  }

  /** Return a point in canvas pixels. @param {number[]} point @returns {[number, number]} */
  toPixels([x, y]) {
    const pixel = this.matrix.transformPoint({ x, y });
    return [pixel.x, pixel.y];
  }

  /** Return the point under the pointer, in units. @param {{clientX: number, clientY: number}} event */
  pointOf({ clientX, clientY }) {
    const { left, top, width } = this.canvas.getBoundingClientRect(), ratio = this.canvas.width / width;
    const { x, y } = this.matrix.inverse().transformPoint({ x: (clientX - left) * ratio, y: (clientY - top) * ratio });
    return [x, y];
  }

  /** Trace a path in units; strokes and fills are in pixels.
   * @param {(context: CanvasRenderingContext2D) => void} trace @param {CanvasRenderingContext2D} [context] */
  inUnits(trace, context = this.context) {
    context.beginPath();
    context.setTransform(this.matrix);
    trace(context);
    context.resetTransform();
    return context;
  }

  /** Stroke the traced path. @param {string} colour @param {number} width @param {number[]} [dash] */
  stroke(colour, width, dash = [], context = this.context) {
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.stroke();
  }

  /** Fill the traced path. @param {string} colour */
  fill(colour) {
    this.context.fillStyle = colour;
    this.context.fill();
  }

  /** Trace a disc with a radius in pixels. @param {number[]} centre @param {number} radius */
  disc(centre, radius) {
    this.context.beginPath();
    this.context.arc(...this.toPixels(centre), radius, 0, 2 * Math.PI);
  }

  /** Write a text. @param {string} text @param {number} x @param {number} y @param {string} colour @param {CanvasTextAlign} [align]
   * @param {number} [size] in pixels of the page */
  write(text, x, y, colour, align = "center", size = 11) {
    const { context } = this;
    context.font = `${size * this.ratio}px system-ui, sans-serif`;
    context.textBaseline = "middle";
    context.textAlign = align;
    context.fillStyle = colour;
    context.fillText(text, x, y);
  }

  /** Register a handler of presses, whose gesture follows the pointer until its release; one gesture at a time.
   * @param {(point: number[]) => Gesture | null} begin */
  hear(begin) {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || this.#gesture) return;
      this.#gesture = begin(this.pointOf(event));
      if (this.#gesture) canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      for (const step of event.getCoalescedEvents?.().slice(0, -1) ?? []) this.#gesture?.move?.(this.pointOf(step));
      this.#gesture?.move?.(this.pointOf(event));
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, () => {
        this.#gesture?.end?.();
        this.#gesture = null;
      });
    }
  }
}
