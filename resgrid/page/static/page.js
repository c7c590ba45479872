// A page: one scene, one wire, one view, and what ties them together.

import { resistorAt, resistorRows } from "./circuit.js";
import { contentsOf, documentIn, openLinking, openNew, openSaving } from "./files.js";
import { readFrame, readLines } from "./frame.js";
import { LAYOUT } from "./layout.js";
import { insideOf, keepScene, keptScene, Model, readScene, sizeOf, writeScene } from "./model.js";
import { Panel, rowsOf } from "./panel.js";
import { partsOf } from "./parts.js";
import { Settling } from "./settling.js";
import { faceAt } from "./shapes.js";
import { Tools } from "./tools.js";
import { openTour } from "./tour.js";
import { paintBar, View } from "./view.js";
import { Newest, Wire } from "./wire.js";
import { World } from "./world.js";

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {import("./frame.js").Frame} Frame */
/** @typedef {Pick<Storage, "getItem" | "setItem">} Shelf where something is kept while nobody looks */

const KEPT = "resgrid drawing", THEME = "resgrid theme", SEEN = "resgrid tour";
const SLOW_MS = 700, KEEP_MS = 400, TOAST_MS = 7000, MOST_BYTES = 5e6;
const KIN = /** @type {const} */ (["cells", "palette", "goals", "starts", "wall", "driven", "edge"]);

export class Page {
  /** The scene of the frame that is shown. @type {Scene | null} */ solved = null;
  /** What tests look at. @type {{at: number, took: number, exact: boolean}[]} */ frames = [];
  #base = "";
  #isReading = false;
  #keeping = 0;
  /** The last certified paths of a chip without flaws, and what they belong to. @type {{scene: Scene, lines: Float32Array[]} | null} */ #ideal = null;
  /** The point under the pointer, in cells. @type {number[] | null} */ #hovered = null;
  #solving = new Newest(() => this.#solve());
  #probing = new Newest(() => this.#probe());
  #ending = new Newest(() => this.#askEnds());
  /** The scene whose paths for both ends of k are known. @type {Scene | null} */ #endsOf = null;
  #resampling = new Newest(() => this.#resample());

  /** @param {HTMLElement} root @param {() => import("./wire.js").Socket} dial
   * @param {{switches: URLSearchParams, shelf: Shelf, keys: EventTarget, address: string, fragment: string}} about
   *   how it is to look, what it keeps, who hears its keys, where links lead, and the link it begins with */
  constructor(root, dial, { switches, shelf, keys, address, fragment }) {
    root.innerHTML = LAYOUT;
    const parts = partsOf(root);
    this.root = root;
    this.parts = parts;
    this.switches = switches;
    this.shelf = shelf;
    this.address = address;
    this.fragment = fragment;
    this.model = new Model();
    this.view = new View(/** @type {HTMLCanvasElement} */ (parts.get("canvas")));
    this.tools = new Tools(this.model, this.view);
    this.tools.fill(parts.get("tools"));
    this.panel = new Panel(parts, this.model, this.tools, this.view);
    this.wire = new Wire(dial);
    this.world = new World(/** @type {HTMLCanvasElement} */ (parts.get("world")), this.model, () => this.#resampling.want(), this.view);
    this.settling = new Settling(parts, this.model, this.wire, this.view, (error) => this.#complain(error));
    this.model.addEventListener("change", (event) => this.#show(/** @type {CustomEvent} */ (event).detail.settled));
    this.wire.addEventListener("lost", () => this.#tell("error", "The server does not answer. What you draw is kept; it goes on when the server is back."));
    this.wire.addEventListener("hello", (event) => this.#greet(/** @type {CustomEvent} */ (event).detail));
    this.#listenToButtons();
    this.#listenToKeys(keys);
    this.#listenToPointer();
    this.#choosePlainLooks();
    this.#tell("busy", "connecting …");
    this.wire.connect();
  }

  /** Nobody looks any more. */
  close() {
    this.view.isClosed = true;
  }

  get #scene() {
    return /** @type {Scene} */ (this.model.scene);
  }

  #listenToButtons() {
    const { parts: { get, input }, model, view, wire } = this, complain = (/** @type {unknown} */ error) => this.#complain(error);
    input("examples").addEventListener("change", () => {
      const { value } = input("examples");
      if (value) this.#open({ type: "example", name: value });
      input("examples").value = "";
    });
    get("undo").addEventListener("click", () => model.undo());
    get("redo").addEventListener("click", () => model.redo());
    get("new").addEventListener("click", () => openNew(this.parts, model));
    get("open").addEventListener("click", () => input("file").click());
    input("file").addEventListener("change", () => {
      this.#openFiles(input("file").files ?? []);
      input("file").value = "";
    });
    get("save").addEventListener("click", () => openSaving(this.parts, wire, () => this.#scene, view.canvas, complain));
    get("share").addEventListener("click", () => openLinking(this.parts, wire, this.#scene, this.address).catch(complain));
    get("help").addEventListener("click", () => openTour(this.parts));
    get("show-ends").addEventListener("shown", () => this.#ending.want());
    get("toast").addEventListener("click", () => { get("toast").hidden = true; });
    get("theme").addEventListener("click", () => {
      const theme = view.dark ? "light" : "dark";
      this.shelf.setItem(THEME, theme);
      this.#dress(theme);
    });
  }

  /** @param {EventTarget} keys */
  #listenToKeys(keys) {
    keys.addEventListener("keydown", (event) => {
      const { ctrlKey, metaKey, shiftKey, key } = /** @type {KeyboardEvent} */ (event), letter = key.toLowerCase();
      if (!(ctrlKey || metaKey) || !this.tools.canDraw) return;
      if (letter === "z" && !shiftKey) this.model.undo();
      else if (letter === "y" || letter === "z") this.model.redo();
      else return;
      event.preventDefault();
    });
    keys.addEventListener("dragover", (event) => event.preventDefault());
    keys.addEventListener("drop", (event) => {
      event.preventDefault();
      const { dataTransfer } = /** @type {DragEvent} */ (event);
      if (dataTransfer?.files.length && this.tools.canDraw) this.#openFiles(dataTransfer.files);
    });
  }

  #listenToPointer() {
    const { view: { canvas }, view } = this;
    const hover = (/** @type {number[] | null} */ point) => {
      this.#hovered = point;
      this.#probing.want();
    };
    for (const kind of /** @type {const} */ (["pointerdown", "pointermove"])) {
      canvas.addEventListener(kind, (event) => {
        const isDrawing = event.buttons && this.tools.tool !== "look";
        hover(isDrawing || !view.scene ? null : view.pointOf(event));
      });
    }
    canvas.addEventListener("pointerleave", (event) => {
      if (event.pointerType !== "touch" || this.tools.tool !== "look") hover(null);
    });
    canvas.addEventListener("walk", (event) => {
      hover(/** @type {CustomEvent} */ (event).detail.map((/** @type {number} */ part) => part + 0.5));
    });
  }

  #choosePlainLooks() {
    const { parts: { get, input }, view } = this;
    const wanted = this.switches.get("theme") ?? this.shelf.getItem(THEME);
    this.#dress(wanted ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) view.shows.dots = input("show-dots").checked = false;
    paintBar(/** @type {HTMLCanvasElement} */ (get("legend-bar")));
  }

  /** @param {string} theme */
  #dress(theme) {
    this.root.dataset.theme = theme;
    this.view.dark = theme === "dark";
    this.view.refresh();
  }

  /** @param {"certified" | "preview" | "busy" | "error"} state @param {string} text */
  #tell(state, text) {
    const quality = this.parts.get("quality");
    quality.dataset.state = state;
    quality.textContent = text;
    this.parts.get("legend").hidden = state === "error";
  }

  /** @param {unknown} error */
  #complain(error) {
    const toast = this.parts.get("toast");
    toast.textContent = error instanceof Error ? error.message : String(error);
    toast.hidden = false;
    clearTimeout(Number(toast.dataset.timer));
    toast.dataset.timer = String(setTimeout(() => { toast.hidden = true; }, TOAST_MS));
  }

  /** The server is there: begin, or go on from where the page was. @param {{head: any, body: Uint8Array}} hello */
  async #greet({ head, body }) {
    const { parts: { get, input }, model, tools, switches, shelf } = this;
    if (model.scene) {
      this.#solving.want();
      return;
    }
    const first = readScene(head, body);
    this.#base = keepScene(first);
    this.#isReading = head.hello.read_only;
    tools.canDraw = this.world.canDraw = !this.#isReading && switches.get("edit") !== "0";
    if (!tools.canDraw) tools.choose("look");
    this.root.classList.toggle("reading", !tools.canDraw);
    this.root.classList.toggle("bare", switches.get("panel") === "0");
    get("examples").replaceChildren(new Option("choose …", ""), ...head.hello.examples.map((/** @type {string} */ name) => new Option(name, name)));
    for (const id of ["examples", "open", "new", "undo", "redo"]) input(id).disabled = !tools.canDraw;
    this.#tell("busy", "the first field …");
    model.reset((this.#isReading ? null : this.#kept()) ?? first);
    await this.follow(this.fragment);
    if (!shelf.getItem(SEEN) && !switches.has("panel") && switches.get("tour") !== "0") openTour(this.parts);
    shelf.setItem(SEEN, "1");
  }

  /** Another scene is there. @param {boolean} settled */
  #show(settled) {
    const scene = this.#scene, { parts: { input }, model } = this;
    this.settling.clear();
    this.view.setScene(scene);
    this.world.setScene(scene);
    this.root.classList.toggle("armed", Boolean(scene.world));
    this.panel.showScene(scene);
    input("undo").disabled = !model.past.length;
    input("redo").disabled = !model.future.length;
    this.#solving.want();
    if (settled) this.#keepSoon();
  }

  #keepSoon() {
    clearTimeout(this.#keeping);
    this.#keeping = setTimeout(() => {
      try {
        if (!this.#isReading) this.shelf.setItem(KEPT, JSON.stringify({ base: this.#base, scene: keepScene(this.#scene) }));
      } catch {
        this.#complain("this drawing is too large to be kept by the browser: save it");
      }
    }, KEEP_MS);
  }

  /** The drawing that was on the page when it was left, if it began with the same scene. */
  #kept() {
    try {
      const record = JSON.parse(this.shelf.getItem(KEPT) ?? "null");
      return record?.base === this.#base ? keptScene(record.scene) : null;
    } catch {
      return null;
    }
  }

  async #solve() {
    const { model: { scene }, wire } = this;
    if (!scene || !wire.isOpen) return;
    const exact = this.model.before === null, began = performance.now();
    const slow = setInterval(() => {
      const seconds = Math.round((performance.now() - began) / 1000);
      const why = this.frames.length ? "solving" : "compiling loops, once";
      if (performance.now() - began > SLOW_MS) this.#tell("busy", `${why} … ${seconds} s`);
    }, 200);
    try {
      const [drawing, body] = writeScene(scene);
      const [head, bytes] = await wire.ask({ type: "solve", exact, drawing }, body);
      const frame = readFrame(head, bytes, sizeOf(scene));
      this.frames.push({ at: performance.now(), took: performance.now() - began, exact: frame.exact });
      if (this.frames.length > 2000) this.frames.splice(0, 1000);
      this.#showFrame(frame, scene);
    } catch (error) {
      if (!wire.isOpen) return;
      this.view.frame = scene === this.model.scene ? null : this.view.frame;
      this.view.refresh();
      const { message } = /** @type {Error} */ (error);
      this.#tell("error", message.split(/[;:]/, 1)[0]);
      this.panel.showError(message);
    } finally {
      clearInterval(slow);
    }
    this.#probing.want();
    this.#ending.want();
  }

  /** @param {Frame} frame @param {Scene} scene that it is of */
  #showFrame(frame, scene) {
    this.solved = scene;
    this.view.setFrame(frame);
    this.#compare(scene, frame);
    this.world.poses = frame.poses.find((poses) => poses.length > 1) ?? [];
    this.panel.showFrame(frame, scene);
    const current = frame.exact && scene === this.model.scene;
    this.#tell(current ? "certified" : "preview", current ? verdict(frame) : "preview, not certified: let go");
  }

  /** Keep the paths of the chip without flaws beside those of the same drawing with some. @param {Scene} scene @param {Frame} frame */
  #compare(scene, frame) {
    const isFlawed = scene.broken.length > 0 || "mismatch" in scene.chip;
    if (!isFlawed && frame.exact) this.#ideal = { scene, lines: frame.lines };
    const ideal = this.#ideal, isKin = ideal !== null && ideal.scene.k === scene.k && areKin(ideal.scene, scene);
    this.view.ideal = isFlawed && ideal && isKin ? ideal.lines : [];
  }

  /** Paths for both ends of k, which are the same for every k. */
  async #askEnds() {
    const { model: { scene }, view } = this;
    const isKnown = scene !== null && this.#endsOf !== null && areKin(scene, this.#endsOf)
      && scene.chip === this.#endsOf.chip && scene.broken === this.#endsOf.broken;
    if (isKnown && view.shows.ends) return;
    view.ends = [];
    this.#endsOf = null;
    if (!view.shows.ends || !scene || scene !== this.solved || scene.driven || !view.frame?.exact) return;
    try {
      const [drawing, cells] = writeScene(scene);
      const [{ points }, body] = await this.wire.ask({ type: "ends", drawing }, cells);
      const lines = readLines(body, points.flat());
      if (scene !== this.model.scene) return;
      view.ends = [lines.slice(0, points[0].length), lines.slice(points[0].length)];
      this.#endsOf = scene;
    } catch (error) {
      this.#complain(error);
    }
  }

  async #probe() {
    const { model: { scene }, view, wire, world } = this, point = this.#hovered;
    const cell = point && scene && insideOf(scene, point.map(Math.floor));
    if (!cell || !point || scene !== this.solved || !view.frame || !wire.isOpen) {
      this.parts.get("card").hidden = true;
      world.hovered = null;
      return;
    }
    const resistor = view.circuit && resistorAt(view.circuit, faceAt(scene, point), point);
    if (resistor) {
      this.#showCard(resistorRows(resistor), cell, scene);
      return;
    }
    try {
      const [{ probe }] = await wire.ask({ type: "probe", cell });
      world.hovered = this.#hovered && probe.kind !== "obstacle" ? probe.pose : null;
      this.#showCard(rowsOf(probe, scene), cell, scene);
    } catch {
      this.parts.get("card").hidden = true;
    }
  }

  /** @param {string[][]} rows of one or two texts @param {number[]} cell that is hovered @param {Scene} scene */
  #showCard(rows, cell, scene) {
    const card = this.parts.get("card"), table = document.createElement("table");
    for (const row of rows) {
      const line = table.insertRow();
      for (const text of row) line.insertCell().textContent = text;
      if (row.length === 1) line.cells[0].colSpan = 2;
    }
    card.replaceChildren(table);
    card.hidden = this.#hovered === null;
    card.classList.toggle("low", this.view.circuit !== null);
    card.classList.toggle("aside", cell[0] > 0.55 * scene.axes[0].cells);
  }

  /** The arm's workspace was changed: sample its cells anew. */
  async #resample() {
    const { scene } = this.model;
    if (!scene?.world) return;
    try {
      const [drawing, body] = writeScene(scene);
      const [head, cells] = await this.wire.ask({ type: "world", drawing }, body);
      if (!this.model.scene?.world) return;
      const { palette, goals, cells: sampled } = readScene(head, cells);
      this.model.show({ ...this.model.scene, palette, goals, cells: sampled });
    } catch (error) {
      this.#complain(error);
    }
  }

  /** Ask for a scene and show it. @param {object} request */
  async #open(request) {
    try {
      const [head, body] = await this.wire.ask(request);
      this.model.replace(readScene(head, body));
    } catch (error) {
      this.#complain(error);
    }
  }

  /** Show the scene of a link. @param {string} fragment */
  async follow(fragment) {
    try {
      const document_ = await documentIn(fragment);
      if (document_) await this.#open({ type: "link", document: document_ });
    } catch {
      this.#complain("this link is damaged: part of it is missing");
    }
  }

  /** @param {Iterable<File>} files */
  async #openFiles(files) {
    const given = [...files];
    if (given.reduce((sum, file) => sum + file.size, 0) > MOST_BYTES) this.#complain("these files are too large: 5 MB at most");
    else await this.#open({ type: "files", files: await contentsOf(given) });
  }
}

/** Whether two scenes differ at most in k and the chip's flaws. @param {Scene} one @param {Scene} other */
const areKin = (one, other) => KIN.every((key) => one[key] === other[key]);

/** @param {Frame} frame */
function verdict(frame) {
  const reached = frame.paths.filter((path) => path.outcome === "reached").length;
  if (!frame.paths.length) return "direction-safe field; no start";
  if (reached === frame.paths.length) return `✓ certified: ${reached === 1 ? "the path reaches" : `${reached} paths reach`} the goal`;
  return `✓ certified: ${reached} of ${frame.paths.length} starts reach a goal`;
}
