// The panel beside the grid: how obstacles behave, what is shown, and what became of every path.

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {import("./frame.js").Frame} Frame */

const WALL_STEPS = 60;
const SHOWN = [["dots", "Current as moving dots"], ["equipotentials", "Equipotentials"], ["arrows", "Arrows"], ["paths", "Paths"], ["circuit", "Circuit, up to 10 × 10 cells"]];

/** Fine near 1, where the Dirichlet field begins to count. @param {number} t */
export const kOf = (t) => Number((1 - (1 - t / 1000) ** 4).toPrecision(6));
/** @param {number} k */
const sliderOf = (k) => Math.round(1000 * (1 - (1 - k) ** 0.25));
/** Ohms in decades around the grid's own. @param {number} t @param {number} ohms */
const wallOf = (t, ohms) => (t ? Number((ohms * 10 ** (-3 + (6 * (t - 1)) / (WALL_STEPS - 1))).toPrecision(4)) : 0);
/** @param {number} wall @param {number} ohms */
const wallSlider = (wall, ohms) => (wall ? Math.max(1, Math.min(WALL_STEPS, Math.round(1 + ((Math.log10(wall / ohms) + 3) / 6) * (WALL_STEPS - 1)))) : 0);

/** A number with a prefix. @param {number} value @param {string} unit */
export function engineering(value, unit) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return `0 ${unit}`;
  const power = Math.max(-24, Math.min(9, Math.floor(Math.log10(Math.abs(value)) / 3) * 3));
  if (Math.abs(value) < 1e-24) return `${value.toExponential(2)} ${unit}`;
  const prefix = { "-24": "y", "-21": "z", "-18": "a", "-15": "f", "-12": "p", "-9": "n", "-6": "µ", "-3": "m", 0: "", 3: "k", 6: "M", 9: "G" };
  return `${Number((value / 10 ** power).toPrecision(4))} ${prefix[/** @type {0} */ (power)]}${unit}`;
}

const HTML = `
  <section><h2>Paths</h2><ul class="paths" id="paths"></ul><span class="note" id="figures"></span></section>
  <section class="editing"><h2>Obstacles</h2>
    <label for="k" class="row"><span>k, share of repulsion</span><output id="k-out"></output></label>
    <input id="k" type="range" min="0" max="1000">
    <div class="ends"><span>0 grazes</span><span>1 repels</span></div>
    <label class="check"><input type="checkbox" id="show-ends">Paths of both ends</label>
    <label for="wall" class="row"><span>Wall resistance</span><output id="wall-out"></output></label>
    <input id="wall" type="range" min="0" max="${WALL_STEPS}">
    <label class="row">Border <select id="edge"><option value="obstacle">obstacle</option><option value="open">open</option></select></label>
    <label class="row">Drive <select id="driven"><option value="">uniform</option><option value="start">the start</option></select></label>
  </section>
  <section class="editing"><h2>Brush</h2>
    <label for="brush" class="row"><span>Width</span><output id="brush-out"></output></label>
    <input id="brush" type="range" min="1" max="15">
    <label class="row">Mud conducts <select id="conductivity">
      <option value="0.3">0.3</option><option value="0.1" selected>0.1</option><option value="0.01">0.01</option><option value="3">3</option></select></label>
  </section>
  <section class="editing"><h2>Flaws of the chip</h2>
    <label for="mismatch" class="row"><span>Mismatch of resistors</span><output id="mismatch-out"></output></label>
    <input id="mismatch" type="range" min="0" max="40">
    <label class="row">Chip number <input id="seed" type="number" min="0" max="999999" step="1"></label>
  </section>
  <section><h2>Time</h2>
    <button id="settle" title="How the chip comes to this field, with 1 pF at every node unless the scene says otherwise">Let it settle</button>
    <div id="film" hidden><label for="moment" class="row"><span id="origin" class="note"></span><output id="time"></output></label>
    <input id="moment" type="range" min="0"></div>
  </section>
  <section><h2>Show</h2>${SHOWN.map(([name, label]) => `<label class="check"><input type="checkbox" id="show-${name}">${label}</label>`).join("")}</section>`;

export class Panel {
  /** @param {import("./parts.js").Parts} parts @param {import("./model.js").Model} model @param {import("./tools.js").Tools} tools
   * @param {import("./view.js").View} view */
  constructor(parts, model, tools, view) {
    this.parts = parts;
    parts.get("panel").innerHTML = HTML;
    this.model = model;
    this.#slider("k", (t) => ({ k: kOf(t) }));
    this.#slider("wall", (t) => ({ wall: wallOf(t, this.#ohms) }));
    this.#select("edge", (rule) => ({ edge: model.scene?.axes.map((axis) => (axis.periodic ? "periodic" : rule)) }));
    this.#select("driven", (drive) => ({ driven: drive === "start", ...(drive ? { k: 0 } : {}) }));
    this.#slider("mismatch", (t) => ({ chip: this.#chip(t / 100, Number(this.parts.input("seed").value)) }));
    this.parts.input("seed").addEventListener("change", () => {
      const seed = Math.max(0, Math.min(999999, Math.round(Number(this.parts.input("seed").value)))) || 0;
      model.replace({ .../** @type {Scene} */ (model.scene), chip: this.#chip(Number(this.parts.input("mismatch").value) / 100, seed) });
    });
    const brush = this.parts.input("brush");
    brush.value = String(tools.brush);
    const brushed = () => {
      tools.brush = Number(brush.value);
      this.parts.get("brush-out").textContent = `${brush.value} ${tools.brush > 1 ? "cells" : "cell"}`;
    };
    brush.addEventListener("input", brushed);
    brushed();
    this.parts.input("conductivity").addEventListener("change", () => {
      tools.conductivity = Number(this.parts.input("conductivity").value);
      tools.choose("cost");
    });
    for (const name of ["ends", ...SHOWN.map(([name]) => name)]) {
      const box = this.parts.input(`show-${name}`), key = /** @type {keyof typeof view.shows} */ (name);
      box.checked = view.shows[key];
      box.addEventListener("change", () => {
        view.shows[key] = box.checked;
        view.refresh();
        box.dispatchEvent(new CustomEvent("shown", { bubbles: true }));
      });
    }
  }

  get #ohms() {
    return /** @type {any} */ (this.model.scene?.chip)?.resistance ?? 1e4;
  }

  /** The chip with a mismatch and a number; without mismatch it says nothing of either. @param {number} sigma @param {number} seed */
  #chip(sigma, seed) {
    const { mismatch, seed: before, ...rest } = /** @type {any} */ (this.model.scene?.chip);
    return sigma ? { ...rest, mismatch: sigma, seed } : rest;
  }

  /** @param {string} name @param {(t: number) => object} change */
  #slider(name, change) {
    const slider = this.parts.input(name);
    slider.addEventListener("input", () => {
      this.model.begin();
      this.model.show({ .../** @type {Scene} */ (this.model.scene), ...change(Number(slider.value)) });
    });
    slider.addEventListener("change", () => this.model.commit());
  }

  /** @param {string} name @param {(value: string) => object} change */
  #select(name, change) {
    const select = this.parts.input(name);
    select.addEventListener("change", () => {
      this.model.replace({ .../** @type {Scene} */ (this.model.scene), ...change(select.value) });
    });
  }

  /** @param {Scene} scene */
  showScene(scene) {
    const set = (/** @type {string} */ name, /** @type {string} */ value) => {
      if (this.parts.input(name).value !== value) this.parts.input(name).value = value;
    };
    if (kOf(Number(this.parts.input("k").value)) !== scene.k) set("k", String(sliderOf(scene.k)));
    set("wall", String(wallSlider(scene.wall, this.#ohms)));
    set("edge", scene.edge.find((rule) => rule !== "periodic") ?? "obstacle");
    set("driven", scene.driven ? "start" : "");
    this.parts.input("k").disabled = this.parts.input("wall").disabled = scene.driven;
    const { mismatch = 0, seed = 0 } = /** @type {any} */ (scene.chip);
    set("mismatch", String(Math.round(100 * mismatch)));
    if (mismatch) set("seed", String(seed));
    this.parts.get("mismatch-out").textContent = mismatch ? `${Math.round(100 * mismatch)} %` : "none";
    this.parts.get("k-out").textContent = String(scene.k);
    this.parts.get("wall-out").textContent = scene.wall ? engineering(scene.wall, "Ω") : "none";
  }

  /** Why there is no field. @param {string} message */
  showError(message) {
    this.parts.get("paths").textContent = message;
    this.parts.get("figures").textContent = "";
  }

  /** @param {Frame} frame @param {Scene} scene */
  showFrame(frame, scene) {
    const unit = scene.axes[0].unit === scene.axes[1].unit ? ` ${scene.axes[0].unit}` : "";
    const number = (/** @type {number | null | undefined} */ value) => (value == null ? "–" : `${Number(value.toPrecision(4))}${unit}`);
    this.parts.get("paths").replaceChildren(...frame.paths.map((path, n) => {
      const item = document.createElement("li"), small = document.createElement("small");
      item.dataset.outcome = path.outcome ?? "";
      item.textContent = `${frame.paths.length > 1 ? `${n + 1}: ` : ""}${(path.outcome ?? "wait").replace("_", " ")}`;
      small.textContent = path.outcome === "reached"
        ? `length ${number(path.length)}, clearance ${number(path.clearance)}, ${path.cells} cells`
        : path.message ?? "";
      item.append(small);
      return item;
    }));
    const isHeight = frame.scale.kind === "height", { low } = frame.scale;
    this.parts.get("legend-low").textContent = isHeight ? "goal 0" : "goal";
    this.parts.get("legend-high").textContent = isHeight ? "1 potential" : `${(-low).toFixed(low > -10 ? 1 : 0)} decades below`;
    if (!frame.paths.length) this.parts.get("paths").textContent = "No start yet: set one with the start tool.";
    const solved = `${frame.nx} × ${frame.ny}, ${frame.methods.join(" and ")}, ${Math.round(frame.seconds * 1000)} ms`;
    const flat = frame.flat.length ? `; the ${frame.flat.join(" and ")} half is flat` : "";
    this.parts.get("figures").textContent = solved + (frame.cut_off ? `; ${frame.cut_off} free cells are cut off` : "") + flat;
  }
}

/** What is known of a cell, as rows. @param {any} about @param {Scene} scene @returns {string[][]} */
export function rowsOf(about, scene) {
  const place = about.centre.map((/** @type {number} */ value, /** @type {number} */ a) => `${scene.axes[a].name} ${Number(value.toPrecision(5))}`);
  const rows = [["cell", about.cell.join(", ")], ["centre", place.join(", ")]];
  if (about.kind !== "free" || about.potential == null) return [...rows, ["", about.kind === "free" ? "cut off" : about.kind]];
  rows.push(["V", engineering(about.volts, "V")]);
  if (about.drop_decades != null) rows.push(["decades of the drop", about.drop_decades.toFixed(2)]);
  ["left", "right", "below", "above"].forEach((side, n) => {
    const amperes = about.amperes[n] * (n % 2 ? 1 : -1);
    const word = amperes > 0 ? "out" : amperes < 0 ? "in" : "";
    rows.push([side, `${word} ${engineering(Math.abs(amperes), "A")}`]);
  });
  if (about.bits != null) rows.push(["converter bits", about.bits.toFixed(1)]);
  return [...rows, ...about.proved.map((/** @type {string} */ text) => [about.exact ? `✓ ${text}` : text])];
}
