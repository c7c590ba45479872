// The rim of the grid: its border, and what its axes are.

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {{x: number, y: number, w: number, h: number, nx: number, ny: number}} Box */

/** The border: thick where it is an obstacle, dashed where it is a seam.
 * @param {CanvasRenderingContext2D} context @param {Scene} scene @param {Box} box @param {string} colour */
export function paintEdge(context, scene, { x, y, w, h, nx, ny }, colour) {
  const right = x + nx * w, bottom = y + ny * h;
  const sides = [[[x, y, x, bottom], [right, y, right, bottom]], [[x, y, right, y], [x, bottom, right, bottom]]];
  sides.forEach((pair, a) => {
    const rule = scene.axes[a].periodic ? "periodic" : scene.edge[a];
    context.strokeStyle = colour;
    context.lineWidth = rule === "obstacle" ? 4 : 1.5;
    context.setLineDash(rule === "periodic" ? [6, 6] : []);
    for (const [x0, y0, x1, y1] of pair) {
      context.beginPath();
      context.moveTo(x0, y0);
      context.lineTo(x1, y1);
      context.stroke();
    }
  });
  context.setLineDash([]);
}

/** Names, units and ends of both axes.
 * @param {CanvasRenderingContext2D} context @param {Scene} scene @param {Box} box @param {number} ratio @param {string} colour */
export function paintAxes(context, scene, { x, y, w, h, nx, ny }, ratio, colour) {
  context.fillStyle = colour;
  context.font = `${11 * ratio}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  scene.axes.forEach(({ name, unit, lower, upper }, a) => {
    const length = a ? ny * h : nx * w;
    context.save();
    context.translate(a ? x - 12 * ratio : x, y + ny * h + (a ? 0 : 12 * ratio));
    if (a) context.rotate(-Math.PI / 2);
    const texts = [[lower, "left", 0], [upper, "right", length]];
    for (const [value, align, at] of /** @type {[number, CanvasTextAlign, number][]} */ (texts)) {
      context.textAlign = align;
      context.fillText(String(Number(value.toPrecision(4))), at, 0);
    }
    context.textAlign = "center";
    context.fillText(unit && unit !== name ? `${name} (${unit})` : name, length / 2, 0);
    context.restore();
  });
}
