// The page: connects the scene, the connection to the server, the canvas and the controls.

import { resistorAt, resistorRows, segmentAt, segmentRows } from "./circuit.js";
import { colours, setColours } from "./colours.js";
import { openExamples } from "./examples.js";
import { contentsOf, documentIn, openLinking, openNew, openSaving } from "./files.js";
import { readFrame, readLines } from "./frame.js";
import { HTML, make, openTour, partsOf } from "./layout.js";
import { insideOf, keepScene, keptScene, Model, OBSTACLE, readScene, sizeOf } from "./model.js";
import { momentRows, Panel, rowsOf, verdictOf } from "./panel.js";
import { Settling } from "./settling.js";
import { faceAt } from "./shapes.js";
import { Tools, TOOLS } from "./tools.js";
import { View } from "./view.js";
import { newest, Wire } from "./wire.js";
import { World } from "./world.js";

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {import("./frame.js").Frame} Frame */
/** @typedef {Pick<Storage, "getItem" | "setItem">} Shelf storage that outlives the page */

const KEPT = "resgrid drawing", THEME = "resgrid theme", SEEN = "resgrid tour";
const SLOW_MS = 700, KEEP_MS = 400, TOAST_MS = 7000, MOST_BYTES = 5e6;
const DRAWN = ["cells", "palette", "goals", "starts", "wall", "leak", "lattice", "driven", "edge"];
/** Properties of a scene on which comparison paths depend. @type {Record<string, string[]>} */
const SAME = { ideal: [...DRAWN, "k"], "k = 0": [...DRAWN, "chip", "broken"], "k = 1": [...DRAWN, "chip", "broken"] };

export class Page {
  /** The scene of the frame that is shown. @type {Scene | null} */ solved = null;
  /** The scene that was solved last after a gesture, from which the server begins transients. @type {Scene | null} */ settled = null;
  /** Times of received frames, for tests. @type {{at: number, took: number, exact: boolean}[]} */ frames = [];
  #base = "";
  #isReading = false;
  #isClosed = false;
  #keeping = 0;
  #hiding = 0;
  /** The scene of the example that was opened last, or with which the page began. @type {Scene | null} */ #opened = null;
  /** The point under the pointer, in cells. @type {number[] | null} */ #hovered = null;
  #solve = newest(() => this.#askField());
  #probe = newest(() => this.#askCell());
  #compare = newest(() => this.#askOthers());

  /** @param {HTMLElement} root @param {() => import("./wire.js").Socket} dial
   * @param {{switches: URLSearchParams, shelf: Shelf, keys: EventTarget, address: string, fragment: string}} about
   *   switches of appearance, storage, source of key events, address of links, and fragment of the initial link */
  constructor(root, dial, about) {
    root.innerHTML = HTML;
    const parts = partsOf(root), model = new Model(), complain = (/** @type {unknown} */ error) => this.#complain(error);
    this.root = root;
    this.about = about;
    this.parts = parts;
    this.model = model;
    this.view = new View(parts.canvas("canvas"));
    this.tools = new Tools(model, this.view, parts.get("tools"));
    this.panel = new Panel(parts, model, this.tools, this.view);
    this.wire = new Wire(dial, {
      hello: (head, body) => this.#greet(head, body),
      lost: () => this.#tell("error", "The server does not answer. The drawing is kept; the page continues when the server is back."),
    });
    this.world = new World(parts.canvas("world"), model, newest(() => this.#askCells()));
    this.settling = new Settling(parts, model, this.wire, this.view, { complain, moved: () => this.#probe() });
    model.addEventListener("rest", () => this.#solve());
    model.addEventListener("change", (event) => this.#show(/** @type {CustomEvent} */ (event).detail.settled));
    this.#listenToControls(complain);
    this.#listenToKeys(about.keys);
    this.#listenToPointer();
    this.#dress(about.switches.get("theme") ?? about.shelf.getItem(THEME) ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) this.view.shows.dots = parts.input("show-dots").checked = false;
    this.#tell("busy", "connecting …");
    this.wire.connect();
    this.#repaint(0);
  }

  /** Stop repainting. */
  close() {
    this.#isClosed = true;
  }

  /** @param {number} now */
  #repaint(now) {
    if (this.#isClosed) return;
    this.view.paint(now);
    this.world.paint(now);
    requestAnimationFrame((then) => this.#repaint(then));
  }

  get #scene() {
    return /** @type {Scene} */ (this.model.scene);
  }

  /** @param {(error: unknown) => void} complain */
  #listenToControls(complain) {
    const { parts, parts: { get, input }, model, view, wire } = this;
    const clicks = {
      undo: () => model.step("past"),
      redo: () => model.step("future"),
      new: () => openNew(parts, model),
      clear: () => model.replace({ cells: this.#scene.cells.map((byte) => byte & ~OBSTACLE) }),
      examples: () => openExamples(parts, this.panel.examples, this.#scene.title, (name) => this.#openExample(name)),
      open: () => input("file").click(),
      save: () => openSaving(parts, wire, this.#scene, complain),
      share: () => openLinking(parts, wire, this.#scene, this.about.address).catch(complain),
      help: () => openTour(parts, TOOLS.map(([, , key]) => key).join(" ")),
      toast: () => { get("toast").hidden = true; },
      theme: () => {
        const theme = view.dark ? "light" : "dark";
        this.about.shelf.setItem(THEME, theme);
        this.#dress(theme);
      },
    };
    for (const [id, click] of Object.entries(clicks)) get(id).addEventListener("click", click);
    input("file").addEventListener("change", () => {
      this.#openFiles(input("file").files ?? []);
      input("file").value = "";
    });
    get("show-ends").addEventListener("change", () => this.#compare());
  }

  /** @param {EventTarget} keys */
  #listenToKeys(keys) {
    keys.addEventListener("keydown", (event) => {
      const { ctrlKey, metaKey, shiftKey, key } = /** @type {KeyboardEvent} */ (event), letter = key.toLowerCase();
      if (!(ctrlKey || metaKey) || !this.tools.canDraw) return;
      if (letter === "z" && !shiftKey) this.model.step("past");
      else if (letter === "y" || letter === "z") this.model.step("future");
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
      this.settling.point(point && view.scene ? insideOf(view.scene, point.map(Math.floor)) : null);
      this.#probe();
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

  /** @param {string} theme */
  #dress(theme) {
    this.root.dataset.theme = theme;
    this.view.dark = this.world.dark = theme === "dark";
    this.view.refresh();
    this.settling.refresh();
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
    clearTimeout(this.#hiding);
    this.#hiding = setTimeout(() => { toast.hidden = true; }, TOAST_MS);
  }

  /** Handle the server's first message: show its scene, or solve the present scene after a reconnection. @param {any} head @param {Uint8Array} body */
  async #greet(head, body) {
    const { parts: { get, input }, model, tools, about: { switches, shelf, fragment } } = this;
    this.settled = null;
    if (model.scene) return this.#solve();
    const first = readScene(head, body);
    setColours(head.hello.colours);
    get("legend-bar").style.background = colours.gradient;
    this.#base = keepScene(first);
    this.#isReading = head.hello.read_only;
    tools.canDraw = this.world.canDraw = !this.#isReading && switches.get("edit") !== "0";
    if (!tools.canDraw) tools.choose("look");
    this.root.classList.toggle("reading", !tools.canDraw);
    this.root.classList.toggle("bare", switches.get("panel") === "0");
    this.panel.examples = head.hello.examples;
    for (const id of ["examples", "open", "new", "clear", "undo", "redo"]) input(id).disabled = !tools.canDraw;
    this.#tell("busy", "computing the first field …");
    if (this.panel.examples.some(({ title }) => title === first.title)) this.#opened = first;
    model.reset((this.#isReading ? null : this.#kept()) ?? first);
    await this.follow(fragment);
    if (!shelf.getItem(SEEN) && !switches.has("panel") && switches.get("tour") !== "0") get("help").click();
    shelf.setItem(SEEN, "1");
    return undefined;
  }

  /** Show a changed scene. @param {boolean} settled */
  #show(settled) {
    const scene = this.#scene, { parts: { input }, model } = this;
    this.settling.clear();
    this.view.setScene(scene);
    this.world.setScene(scene);
    this.root.classList.toggle("armed", Boolean(scene.world));
    this.panel.showScene(scene);
    this.#showTitle();
    input("undo").disabled = !model.past.length;
    input("redo").disabled = !model.future.length;
    input("clear").disabled = !this.tools.canDraw || !scene.cells.some((byte) => byte & OBSTACLE);
    this.#solve();
    if (settled) this.#keepSoon();
  }

  /** Show the title of the scene, and whether the example that was opened last has been changed. */
  #showTitle() {
    const { parts: { get }, model: { scene } } = this, opened = this.#opened;
    if (!scene) return;
    const isChanged = opened && opened !== scene && opened.title === scene.title;
    get("title").textContent = `${scene.title || "Drawing"}${isChanged ? " (changed)" : ""}`;
    get("example-heading").textContent = isChanged ? "In the example before your changes" : "In this example";
  }

  #keepSoon() {
    clearTimeout(this.#keeping);
    if (this.#isReading) return;
    this.#keeping = setTimeout(() => {
      try {
        this.about.shelf.setItem(KEPT, JSON.stringify({ base: this.#base, scene: keepScene(this.#scene) }));
      } catch {
        this.#complain("this drawing is too large for the browser's storage: save it to a file");
      }
    }, KEEP_MS);
  }

  /** Return the stored drawing if it began with the same scene; otherwise null. */
  #kept() {
    try {
      const record = JSON.parse(this.about.shelf.getItem(KEPT) ?? "null");
      return record?.base === this.#base ? keptScene(record.scene) : null;
    } catch {
      return null;
    }
  }

  /** Request the field of the present scene, unless its exact field is shown and known to the server as settled. */
  async #askField() {
    const { model: { scene }, wire } = this;
    if (!scene || !wire.isOpen || (scene === this.settled && scene === this.solved && this.view.frame?.exact)) return;
    const exact = this.model.before === null, began = performance.now(), why = this.frames.length ? "solving" : "compiling kernels, once";
    const slow = setInterval(() => {
      const waited = performance.now() - began;
      if (waited > SLOW_MS) this.#tell("busy", `${why} … ${Math.round(waited / 1000)} s`);
    }, 200);
    try {
      const [head, body] = await wire.ask({ type: "solve", exact }, scene), frame = readFrame(head, body, sizeOf(scene));
      this.frames.push({ at: performance.now(), took: performance.now() - began, exact: frame.exact });
      if (this.frames.length > 2000) this.frames.splice(0, 1000);
      if (exact) this.settled = scene;
      this.#showFrame(frame, scene);
    } catch (error) {
      if (!wire.isOpen) return;
      if (scene === this.model.scene) this.view.setFrame(null);
      const { message } = /** @type {Error} */ (error);
      this.#tell("error", message.split(/[;:]/, 1)[0]);
      this.panel.showError(message);
    } finally {
      clearInterval(slow);
    }
    this.#probe();
    this.#compare();
  }

  /** @param {Frame} frame @param {Scene} scene of the frame */
  #showFrame(frame, scene) {
    this.solved = scene;
    this.view.setFrame(frame);
    this.world.poses = frame.poses.find((poses) => poses.length > 1) ?? [];
    this.panel.showFrame(frame, scene);
    const current = frame.exact && scene === this.model.scene;
    this.#tell(current ? "certified" : "preview", current ? verdictOf(frame, scene) : "preview, certified after release");
  }

  /** Request missing comparison paths (ideal chip, k = 0, k = 1), and drop those that are not shown or outdated. */
  async #askOthers() {
    const { model: { scene }, view } = this;
    if (!scene) return;
    const wanted = view.shows.ends && !scene.driven ? ["k = 0", "k = 1"] : [];
    if (scene.broken.length || "mismatch" in scene.chip) wanted.unshift("ideal");
    view.others = view.others.filter(({ name, scene: other }) => wanted.includes(name) && areSame(SAME[name], other, scene));
    const missing = wanted.filter((name) => view.others.every((known) => known.name !== name));
    if (!missing.length || scene !== this.solved || !view.frame?.exact) return;
    try {
      const [{ points }, body] = await this.wire.ask({ type: "paths", paths: missing }, scene), lines = readLines(body, points.flat());
      if (scene !== this.model.scene) return;
      const known = missing.map((name, n) => ({ name, scene, lines: lines.splice(0, points[n].length) }));
      view.others = [...view.others, ...known];
    } catch (error) {
      this.#complain(error);
    }
  }

  /** Show the properties of the cell or resistor under the pointer. */
  async #askCell() {
    const { model: { scene }, view, wire, world, parts: { get } } = this, point = this.#hovered;
    const cell = point && scene && insideOf(scene, point.map(Math.floor));
    if (!cell || !point || scene !== this.solved || !view.frame || !wire.isOpen) {
      get("card").hidden = true;
      world.hovered = null;
      return;
    }
    const moment = this.settling.at(cell);
    if (moment) return this.#showCard(momentRows(moment, cell, scene), cell, scene);
    const resistor = view.circuit && resistorAt(view.circuit, faceAt(scene, point), point);
    if (resistor) return this.#showCard(resistorRows(resistor), cell, scene);
    const segment = view.circuit && segmentAt(view.circuit, point);
    if (segment) return this.#showCard(segmentRows(segment), cell, scene);
    try {
      const [{ probe }] = await wire.ask({ type: "probe", cell });
      world.hovered = this.#hovered && probe.kind !== "obstacle" ? probe.pose : null;
      this.#showCard(rowsOf(probe, scene), cell, scene);
    } catch {
      get("card").hidden = true;
    }
  }

  /** @param {string[][]} rows of one or two texts @param {number[]} cell that is hovered @param {Scene} scene */
  #showCard(rows, cell, scene) {
    const card = this.parts.get("card"), table = make("table", {});
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

  /** Request the cells for a changed workspace of the arm. */
  async #askCells() {
    const { scene } = this.model;
    if (!scene?.world) return;
    try {
      const { palette, goals, cells, goal_points } = readScene(...await this.wire.ask({ type: "world" }, scene));
      const now = this.model.scene;
      if (now?.world && areSame(["axes"], now, scene) && areSame(["robot"], now.world, scene.world)) this.model.show({ palette, goals, cells, goal_points });
    } catch (error) {
      this.#complain(error);
    }
  }

  /** @param {string} name */
  async #openExample(name) {
    const isOpen = await this.#open({ type: "example", name });
    if (isOpen) this.#opened = this.#scene;
    this.#showTitle();
  }

  /** Request a scene and show it; return whether this succeeded. @param {object} request */
  async #open(request) {
    try {
      this.model.replace(readScene(...await this.wire.ask(request)));
      return true;
    } catch (error) {
      this.#complain(error);
      return false;
    }
  }

  /** Show the scene of a link. @param {string} fragment */
  async follow(fragment) {
    try {
      const document_ = await documentIn(fragment);
      if (document_) await this.#open({ type: "link", document: document_ });
    } catch {
      this.#complain("this link is incomplete or damaged: copy the whole link again");
    }
  }

  /** @param {Iterable<File>} files */
  async #openFiles(files) {
    const given = [...files];
    if (given.reduce((sum, file) => sum + file.size, 0) > MOST_BYTES) this.#complain("these files exceed the limit of 5 MB; choose smaller files");
    else await this.#open({ type: "files", files: await contentsOf(given) });
  }
}

/** Return whether two scenes have equal values of some properties. @param {string[]} keys @param {any} one @param {any} other */
const areSame = (keys, one, other) => keys.every((key) => one[key] === other[key]);
