// The panel next to the grid: outcomes of paths, and controls of the circuit and the display.

import { engineering } from "./circuit.js";
import { make } from "./layout.js";
import { centreOf } from "./model.js";
import { placeOf } from "./names.js";
import { kOf, kSlider, LEAK_STEPS, leakOf, leakOhms, leakSlider, ohmsOf, WALL_STEPS, wallOf, wallSlider } from "./scales.js";

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {import("./frame.js").Frame} Frame */

const SHOWN = [["dots", "Current as moving dots"], ["equipotentials", "Equipotentials"], ["arrows", "Arrows"], ["paths", "Paths"], ["circuit", "Circuit, up to 10 × 10 cells"]];

/** Value, text and explanation of every lattice. */
const LATTICES = [
  ["square", "4 neighbours", "faces of cells; paths are streamlines"],
  ["square8", "8 neighbours", "also across corners; paths lead from node to node along the largest current density"],
  ["hexagonal", "6 neighbours", "a triangular lattice; paths lead from node to node along the largest current density"],
];

/** @param {string} id @param {string} label @param {number} max @param {number} [min] */
const slider = (id, label, max, min = 0) => `<label for="${id}" class="row"><span>${label}</span><output id="${id}-out"></output></label>
  <input id="${id}" type="range" min="${min}" max="${max}">`;
/** @param {string} id @param {string} label @param {string[][]} options values and texts */
const select = (id, label, options) => `<label class="row">${label} <select id="${id}">${options.map(([value, text]) => `<option value="${value}">${text}</option>`).join("")}</select></label>`;
/** @param {string} name @param {string} label */
const check = (name, label) => `<label class="check"><input type="checkbox" id="show-${name}">${label}</label>`;

const HTML = `
  <section id="example" hidden><h2 id="example-heading"></h2><p id="about"></p></section>
  <section><h2>Paths</h2><ul class="paths" id="paths"></ul><span class="note" id="figures"></span></section>
  <section class="editing"><h2>Obstacles</h2>
    ${slider("k", "k, weight of repulsion", 1000)}
    <div class="ends"><span>0: open</span><span>1: repelling</span></div>
    ${check("ends", "Paths for k = 0 and k = 1")}
    ${slider("wall", "Wall resistance", WALL_STEPS)}
    <span class="note">equal for all obstacles</span>
    ${select("edge", "Border", [["obstacle", "obstacle"], ["open", "open"]])}
    ${select("driven", "Drive", [["", "uniform"], ["start", "the start"]])}
  </section>
  <section class="editing"><h2>Grid</h2>
    ${select("lattice", "Lattice", LATTICES)}
    <span class="note" id="lattice-note"></span>
    ${slider("leak", "Leak to the obstacle rail", LEAK_STEPS)}
    <span class="note" id="leak-note"></span>
  </section>
  <section class="editing"><h2>Brush</h2>
    ${slider("brush", "Width", 15, 1)}
    ${select("conductivity", "Conductivity of mud", [["3", "3"], ["0.3", "0.3"], ["0.1", "0.1"], ["0.01", "0.01"]])}
  </section>
  <section class="editing"><h2>Imperfections</h2>
    ${slider("mismatch", "Mismatch of resistors", 40)}
    <label class="row">Chip number <input id="seed" type="number" value="0" min="0" max="999999" step="1"></label>
  </section>
  <section><h2>Time</h2>
    <button id="settle" title="Transient of the circuit, with 1 pF at every node unless the scene has a capacitance">Show transient</button>
    <span class="note">animation, and voltage under the pointer over time</span>
  </section>
  <section><h2>Show</h2>${SHOWN.map(([name, label]) => check(name, label)).join("")}</section>`;

/** Return the change of a scene's chip for a mismatch and a seed; without mismatch, both keys are removed. @param {Scene} scene @param {number} sigma @param {number} seed */
function flawed({ chip }, sigma, seed) {
  const { mismatch, seed: before, ...rest } = /** @type {any} */ (chip);
  return { chip: sigma ? { ...rest, mismatch: sigma, seed } : rest };
}

/** Return the reasons why controls are disabled, by control; empty texts for enabled ones. @param {Scene} scene @returns {Record<string, string>} */
function reasonsOf({ driven, leak, lattice = "square", broken, chip }) {
  const byStart = driven ? "The start drives the grid, and obstacles are open: choose the uniform drive." : "";
  const needsSquare = lattice === "square" ? "" : "This needs the lattice with 4 neighbours: choose it first.";
  const isFlawed = broken.length > 0 || "mismatch" in chip;
  return {
    k: byStart, wall: byStart, leak: byStart || needsSquare, mismatch: needsSquare, seed: needsSquare, settle: needsSquare,
    driven: leak ? "The leak drives the grid with open obstacles: set it to none first." : "",
    lattice: isFlawed ? "Mismatch and open resistors need 4 neighbours: set the mismatch to none and repair the resistors first."
      : leak ? "The leak needs 4 neighbours: set it to none first." : "",
  };
}

/** For every control: change of the scene (write), value from the scene (read), and text next to it (say).
 * @type {Record<string, {write: (value: string, scene: Scene, other: (id: string) => string) => Partial<Scene>,
 *   read: (scene: Scene, value: string) => number | string, say?: (scene: Scene) => string}>} */
const CONTROLS = {
  k: {
    write: (value) => ({ k: kOf(Number(value)) }),
    read: ({ k }, value) => (kOf(Number(value)) === k ? value : kSlider(k)),
    say: ({ k }) => String(k),
  },
  wall: {
    write: (value, scene) => ({ wall: wallOf(Number(value), ohmsOf(scene)) }),
    read: (scene) => wallSlider(scene.wall, ohmsOf(scene)),
    say: ({ wall }) => (wall ? engineering(wall, "Ω") : "none"),
  },
  lattice: {
    write: (lattice) => ({ lattice }),
    read: ({ lattice = "square" }) => lattice,
  },
  leak: {
    write: (value, scene) => ({ leak: leakOf(Number(value), scene) }),
    read: (scene, value) => (leakOf(Number(value), scene) === (scene.leak ?? 0) ? value : leakSlider(scene)),
    say: ({ leak, axes }) => (leak ? `${leak} / ${axes[0].unit || "unit"}²` : "none"),
  },
  edge: {
    write: (rule, { axes }) => ({ edge: axes.map(({ periodic }) => (periodic ? "periodic" : rule)) }),
    read: ({ edge }) => edge.find((rule) => rule !== "periodic") ?? "obstacle",
  },
  driven: {
    write: (drive) => (drive ? { driven: true, k: 0 } : { driven: false }),
    read: ({ driven }) => (driven ? "start" : ""),
  },
  mismatch: {
    write: (value, scene, other) => flawed(scene, Number(value) / 100, Number(other("seed"))),
    read: ({ chip }) => Math.round(100 * (/** @type {any} */ (chip).mismatch ?? 0)),
    say: ({ chip }) => ("mismatch" in chip ? `${Math.round(100 * Number(chip.mismatch))} %` : "none"),
  },
  seed: {
    write: (value, scene, other) => flawed(scene, Number(other("mismatch")) / 100, Math.max(0, Math.min(999999, Math.round(Number(value)))) || 0),
    read: ({ chip }, value) => ("mismatch" in chip ? /** @type {any} */ (chip).seed ?? 0 : value),
  },
};

export class Panel {
  /** Examples in the order of the menu. @type {import("./examples.js").Example[]} */ examples = [];

  /** @param {import("./layout.js").Parts} parts @param {import("./model.js").Model} model @param {import("./tools.js").Tools} tools
   * @param {import("./view.js").View} view */
  constructor(parts, model, tools, view) {
    const { get, input } = parts;
    this.parts = parts;
    this.tools = tools;
    get("panel").innerHTML = HTML;
    for (const [id, { write }] of Object.entries(CONTROLS)) {
      input(id).addEventListener(input(id).type === "number" ? "change" : "input", () => {
        model.begin();
        model.show(write(input(id).value, /** @type {Scene} */ (model.scene), (other) => input(other).value));
      });
      input(id).addEventListener("change", () => model.commit());
    }
    const setBrush = () => {
      tools.brush = Number(input("brush").value);
      get("brush-out").textContent = `${tools.brush} ${tools.brush > 1 ? "cells" : "cell"}`;
    };
    input("brush").value = String(tools.brush);
    input("brush").addEventListener("input", setBrush);
    setBrush();
    input("conductivity").value = String(tools.conductivity);
    input("conductivity").addEventListener("change", () => {
      tools.conductivity = Number(input("conductivity").value);
      tools.choose("cost");
    });
    for (const name of /** @type {(keyof typeof view.shows)[]} */ (Object.keys(view.shows))) {
      input(`show-${name}`).checked = view.shows[name];
      input(`show-${name}`).addEventListener("change", () => {
        view.shows[name] = input(`show-${name}`).checked;
        view.refresh();
      });
    }
  }

  /** @param {Scene} scene */
  showScene(scene) {
    const { get, input } = this.parts, example = this.examples.find(({ title }) => title === scene.title);
    get("example").hidden = !example;
    get("about").textContent = example?.about ?? "";
    for (const [id, { read, say }] of Object.entries(CONTROLS)) {
      const value = String(read(scene, input(id).value));
      if (input(id).value !== value) input(id).value = value;
      if (say) get(`${id}-out`).textContent = say(scene);
    }
    const { leak, axes: [{ unit }] } = scene, length = leak ? Number((leak ** -0.5).toPrecision(3)) : 0;
    get("leak-note").textContent = leak
      ? `screening length ${length} ${unit || "units"}; ${engineering(leakOhms(scene), "Ω", 3)} from every node to the obstacle rail`
      : "a resistor from every node to the obstacle rail";
    get("lattice-note").textContent = LATTICES.find(([value]) => value === (scene.lattice ?? "square"))?.[2] ?? "";
    const reasons = reasonsOf(scene);
    for (const [id, reason] of Object.entries(reasons)) this.#allow(id, reason);
    this.tools.allow("snap", reasons.mismatch);
  }

  /** Enable a control, or disable it with the reason as its tooltip. @param {string} id @param {string} reason empty if it is enabled */
  #allow(id, reason) {
    const input = this.parts.input(id), label = input.closest("label") ?? input.previousElementSibling;
    input.dataset.title ??= input.title;
    input.disabled = Boolean(reason);
    input.title = reason || input.dataset.title;
    if (label instanceof HTMLLabelElement) label.title = reason;
  }

  /** Show the reason why there is no field. @param {string} message */
  showError(message) {
    this.parts.get("paths").textContent = message;
    this.parts.get("figures").textContent = "";
  }

  /** @param {Frame} frame @param {Scene} scene */
  showFrame({ paths, scale, methods, seconds, flat, cut_off: cutOff, nx, ny }, { axes }) {
    const { get } = this.parts, unit = axes[0].unit === axes[1].unit ? ` ${axes[0].unit}` : "";
    const number = (/** @type {number | null | undefined} */ value) => (value == null ? "–" : `${Number(value.toPrecision(4))}${unit}`);
    get("paths").replaceChildren(...paths.map((path, n) => {
      const about = path.outcome === "reached" ? `length ${number(path.length)}, clearance ${number(path.clearance)}, ${path.cells} cells` : path.message ?? "";
      const name = `${paths.length > 1 ? `${n + 1}: ` : ""}${(path.outcome ?? "wait").replace("_", " ")}`;
      const item = make("li", {}, name, make("small", { textContent: about }));
      item.dataset.outcome = path.outcome ?? "";
      return item;
    }));
    if (!paths.length) get("paths").textContent = "No start: set a start with the start tool.";
    const isHeight = scale.kind === "height", decades = -scale.low;
    get("legend-low").textContent = isHeight ? "goal: potential 0" : "goal";
    get("legend-cut").hidden = !cutOff;
    get("legend-high").textContent = isHeight ? "1" : `${decades.toFixed(decades < 10 ? 1 : 0)} decades below`;
    get("figures").textContent = `${nx} × ${ny}, ${methods.join(" and ")}, ${Math.round(seconds * 1000)} ms`
      + (cutOff ? `; ${cutOff} free cells without a path to a goal` : "") + (flat.length ? `; the ${flat.join(" and ")} field is zero` : "");
  }
}

/** @param {number} decades */
const signed = (decades) => (Math.abs(decades) < 0.005 ? "0" : decades.toFixed(2).replace("-", "−"));

/** Return the properties of a cell at a time of the transient, as rows.
 * @param {{time: number, volts: number, decades: number | null}} moment @param {number[]} cell @param {Scene} scene */
export function momentRows({ time, volts, decades }, cell, scene) {
  const rows = [["cell", cell.join(", ")], ["centre", placeOf(centreOf(scene, cell), scene)]];
  if (!Number.isFinite(volts)) return [...rows, ["", "no node"]];
  rows.push([`V at ${engineering(time, "s", 3)}`, engineering(volts, "V")]);
  if (decades != null) rows.push(["drop, log₁₀", signed(decades)]);
  return rows;
}

/** Return the properties of a cell, as rows. @param {any} about @param {Scene} scene @returns {string[][]} */
export function rowsOf(about, scene) {
  const rows = [["cell", about.cell.join(", ")], ["centre", placeOf(about.centre, scene)]];
  if (about.kind !== "free" || about.potential == null) return [...rows, ["", about.kind === "free" ? "no path to a goal" : about.kind]];
  rows.push(about.volts == null ? ["potential", about.potential.toPrecision(4)] : ["V", engineering(about.volts, "V")]);
  if (about.drop_decades != null) rows.push(["drop, log₁₀", signed(about.drop_decades)]);
  for (const [arrow, amperes, isNext] of about.steps ?? []) rows.push([`${arrow}${isNext ? " next" : ""}`, `${amperes > 0 ? "out" : amperes < 0 ? "in" : ""} ${engineering(Math.abs(amperes), "A")}`]);
  if (about.amperes) ["left", "right", "below", "above"].forEach((side, n) => {
    const amperes = about.amperes[n] * (n % 2 ? 1 : -1), word = amperes > 0 ? "out" : amperes < 0 ? "in" : "";
    rows.push([side, `${word} ${engineering(Math.abs(amperes), "A")}`]);
  });
  if (about.bits != null) rows.push(["converter bits", about.bits.toFixed(1)]);
  return [...rows, ...about.proved.map((/** @type {string} */ text) => [about.exact ? `✓ ${text}` : text])];
}

/** Return a short text on the outcomes of all paths. @param {Frame} frame @param {Scene} scene */
export function verdictOf(frame, { goals }) {
  const reached = frame.paths.filter((path) => path.outcome === "reached").length;
  if (!frame.paths.length) return "direction-safe field; no start";
  const goal = goals.length === 1 ? "the goal" : "a goal";
  if (reached === frame.paths.length) return `✓ certified: ${["no path reaches", "the path reaches", "both paths reach"][reached] ?? `all ${reached} paths reach`} ${goal}`;
  return `✓ certified: ${reached} of ${frame.paths.length} starts ${reached === 1 ? "reaches" : "reach"} ${goal}`;
}
