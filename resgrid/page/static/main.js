// The page: one scene, one wire, one view, and what ties them together.

import { contentsOf, documentIn, openLinking, openNew, openSaving } from "./files.js";
import { resistorAt, resistorRows } from "./circuit.js";
import { readFrame } from "./frame.js";
import { insideOf, keepScene, keptScene, Model, readScene, sizeOf, writeScene } from "./model.js";
import { get, input, Panel, rowsOf } from "./panel.js";
import { Settling } from "./settling.js";
import { faceAt } from "./shapes.js";
import { Tools } from "./tools.js";
import { openTour } from "./tour.js";
import { paintBar, View } from "./view.js";
import { Newest, Wire } from "./wire.js";
import { World } from "./world.js";

/** @typedef {import("./model.js").Scene} Scene */

const KEPT = "resgrid drawing", THEME = "resgrid theme", SEEN = "resgrid tour";
const SLOW_MS = 700, KEEP_MS = 400, TOAST_MS = 7000;

const model = new Model();
const view = new View(/** @type {HTMLCanvasElement} */ (get("canvas")));
const tools = new Tools(model, view);
const panel = new Panel(get("panel"), model, tools, view);
tools.fill(get("tools"));
const wire = new Wire(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
const switches = new URLSearchParams(location.search);
const world = new World(/** @type {HTMLCanvasElement} */ (get("world")), model, () => resampling.want(), view);
const settling = new Settling(model, wire, view, complain);
let base = "", isReading = false, solvedOnce = false;
/** @type {Scene | null} */ let solved = null;
/** The last certified paths of a chip without flaws, and what they belong to. @type {{scene: Scene, lines: Float32Array[]} | null} */
let ideal = null;
/** The cell and the point under the pointer. @type {number[] | null} */ let hovered = null, /** @type {number[] | null} */ hoveredPoint = null;
/** What tests and frames around the page may look at. */
const live = { model, view, world, wire, tools, frames: /** @type {{at: number, took: number, exact: boolean}[]} */ ([]), get solved() { return solved; } };
Object.assign(window, { live });

/** @param {"certified" | "preview" | "busy" | "error"} state @param {string} text */
function tell(state, text) {
  get("quality").dataset.state = state;
  get("quality").textContent = text;
  get("legend").hidden = state === "error";
}

/** @param {unknown} error */
function complain(error) {
  const toast = get("toast");
  toast.textContent = error instanceof Error ? error.message : String(error);
  toast.hidden = false;
  clearTimeout(Number(toast.dataset.timer));
  toast.dataset.timer = String(setTimeout(() => { toast.hidden = true; }, TOAST_MS));
}

const solving = new Newest(async () => {
  const scene = model.scene;
  if (!scene || !wire.isOpen) return;
  const exact = model.before === null, began = performance.now();
  const slow = setInterval(() => {
    const seconds = Math.round((performance.now() - began) / 1000);
    const why = solvedOnce ? "solving" : "the first field: loops are being compiled, once, up to a minute";
    if (performance.now() - began > SLOW_MS) tell("busy", `${why} … ${seconds} s`);
  }, 200);
  try {
    const [drawing, body] = writeScene(scene);
    const [head, bytes] = await wire.ask({ type: "solve", exact, drawing }, body);
    const frame = readFrame(head, bytes, sizeOf(scene));
    solvedOnce = true;
    solved = scene;
    live.frames.push({ at: performance.now(), took: performance.now() - began, exact: frame.exact });
    if (live.frames.length > 2000) live.frames.splice(0, 1000);
    view.setFrame(frame);
    compare(scene, frame);
    world.poses = frame.poses.find((poses) => poses.length > 1) ?? [];
    panel.showFrame(frame, scene);
    showScale(frame);
    const current = frame.exact && scene === model.scene;
    tell(current ? "certified" : "preview", current ? verdict(frame) : "preview, not certified: let go");
  } catch (error) {
    if (!wire.isOpen) return;
    view.frame = scene === model.scene ? null : view.frame;
    view.refresh();
    const { message } = /** @type {Error} */ (error);
    tell("error", message.split(/[;:]/, 1)[0]);
    panel.showError(message);
  } finally {
    clearInterval(slow);
  }
  probing.want();
});

/** Keep the paths of the chip without flaws beside those of the same drawing with some.
 * @param {Scene} scene @param {import("./frame.js").Frame} frame */
function compare(scene, frame) {
  const isFlawed = scene.broken.length > 0 || "mismatch" in scene.chip;
  if (!isFlawed && frame.exact) ideal = { scene, lines: frame.lines };
  const same = (/** @type {"cells" | "goals" | "starts" | "k" | "wall" | "driven" | "edge"} */ key) => ideal?.scene[key] === scene[key];
  const isKin = same("cells") && same("goals") && same("starts") && same("k") && same("wall") && same("driven") && same("edge");
  view.ideal = isFlawed && ideal && isKin ? ideal.lines : [];
}

/** @param {import("./frame.js").Frame} frame */
function verdict(frame) {
  const reached = frame.paths.filter((path) => path.outcome === "reached").length;
  if (!frame.paths.length) return "direction-safe field; no start";
  if (reached === frame.paths.length) return `✓ certified: ${reached === 1 ? "the path reaches" : `${reached} paths reach`} the goal`;
  return `✓ certified: ${reached} of ${frame.paths.length} starts reach a goal`;
}

/** @param {import("./frame.js").Frame} frame */
function showScale({ scale }) {
  const isHeight = scale.kind === "height";
  get("legend-low").textContent = isHeight ? "goal 0" : "goal";
  get("legend-high").textContent = isHeight ? "1 potential" : `${(-scale.low).toFixed(scale.low > -10 ? 1 : 0)} decades below`;
}

const probing = new Newest(async () => {
  const scene = model.scene, cell = hovered && scene && insideOf(scene, hovered);
  const card = get("card");
  if (!cell || scene !== solved || !view.frame || !wire.isOpen) {
    card.hidden = true;
    world.hovered = null;
    return;
  }
  const resistor = view.circuit && hoveredPoint && resistorAt(view.circuit, faceAt(scene, hoveredPoint), hoveredPoint);
  if (resistor) return showCard(resistorRows(resistor), cell, scene);
  try {
    const [{ probe }] = await wire.ask({ type: "probe", cell });
    world.hovered = hovered && probe.kind !== "obstacle" ? probe.pose : null;
    showCard(rowsOf(probe, scene), cell, scene);
  } catch {
    card.hidden = true;
  }
});

/** @param {string[][]} rows of one or two texts @param {number[]} cell that is hovered @param {Scene} scene */
function showCard(rows, cell, scene) {
  const card = get("card"), table = document.createElement("table");
  for (const row of rows) {
    const line = table.insertRow();
    for (const text of row) line.insertCell().textContent = text;
    if (row.length === 1) line.cells[0].colSpan = 2;
  }
  card.replaceChildren(table);
  card.hidden = hovered === null;
  card.classList.toggle("low", view.circuit !== null);
  card.classList.toggle("aside", cell[0] > 0.55 * scene.axes[0].cells);
}

const resampling = new Newest(async () => {
  const scene = model.scene;
  if (!scene?.world) return;
  try {
    const [drawing, body] = writeScene(scene);
    const [head, cells] = await wire.ask({ type: "world", drawing }, body);
    if (!model.scene?.world) return;
    const { palette, goals, cells: sampled } = readScene(head, cells);
    model.show({ ...model.scene, palette, goals, cells: sampled });
  } catch (error) {
    complain(error);
  }
});

model.addEventListener("change", (event) => {
  const scene = /** @type {Scene} */ (model.scene);
  settling.clear();
  view.setScene(scene);
  world.setScene(scene);
  document.body.classList.toggle("armed", Boolean(scene.world));
  panel.showScene(scene);
  document.title = `${scene.title || "Drawing"} – resgrid live`;
  input("undo").disabled = !model.past.length;
  input("redo").disabled = !model.future.length;
  solving.want();
  if (/** @type {CustomEvent} */ (event).detail.settled) keepSoon();
});

let keeping = 0;
function keepSoon() {
  clearTimeout(keeping);
  keeping = setTimeout(() => {
    try {
      if (!isReading) localStorage.setItem(KEPT, JSON.stringify({ base, scene: keepScene(/** @type {Scene} */ (model.scene)) }));
    } catch {
      complain("this drawing is too large to be kept by the browser: save it");
    }
  }, KEEP_MS);
}

/** The drawing that was on the page when it was left, if it began with the same scene. */
function kept() {
  try {
    const record = JSON.parse(localStorage.getItem(KEPT) ?? "null");
    return record?.base === base ? keptScene(record.scene) : null;
  } catch {
    return null;
  }
}

wire.addEventListener("lost", () => tell("error", "The server does not answer. What you draw is kept; it goes on when the server is back."));
wire.addEventListener("hello", async (event) => {
  const { head, body } = /** @type {CustomEvent} */ (event).detail;
  if (model.scene) return solving.want();
  const first = readScene(head, body);
  base = keepScene(first);
  isReading = head.hello.read_only;
  tools.canDraw = world.canDraw = !isReading && switches.get("edit") !== "0";
  if (!tools.canDraw) tools.choose("look");
  document.body.classList.toggle("reading", !tools.canDraw);
  document.body.classList.toggle("bare", switches.get("panel") === "0");
  get("examples").replaceChildren(new Option("choose …", ""), ...head.hello.examples.map((/** @type {string} */ name) => new Option(name, name)));
  for (const id of ["examples", "open", "new", "undo", "redo"]) input(id).disabled = !tools.canDraw;
  tell("busy", "the first field …");
  model.reset((isReading ? null : kept()) ?? first);
  await followLink();
  if (!localStorage.getItem(SEEN) && !switches.has("panel") && switches.get("tour") !== "0") openTour();
  localStorage.setItem(SEEN, "1");
  return undefined;
});

/** Ask for a scene and show it. @param {object} request */
async function open(request) {
  try {
    const [head, body] = await wire.ask(request);
    model.replace(readScene(head, body));
  } catch (error) {
    complain(error);
  }
}

async function followLink() {
  try {
    const document_ = await documentIn(location.hash);
    if (document_) await open({ type: "link", document: document_ });
  } catch {
    complain("this link is damaged: part of it is missing");
  }
}

/** @param {Iterable<File>} files */
async function openFiles(files) {
  const given = [...files];
  if (given.reduce((sum, file) => sum + file.size, 0) > 5e6) return complain("these files are too large: 5 MB at most");
  return open({ type: "files", files: await contentsOf(given) });
}

get("examples").addEventListener("change", () => {
  const { value } = input("examples");
  if (value) open({ type: "example", name: value });
  input("examples").value = "";
});
get("undo").addEventListener("click", () => model.undo());
get("redo").addEventListener("click", () => model.redo());
get("new").addEventListener("click", () => openNew(model));
get("open").addEventListener("click", () => input("file").click());
get("file").addEventListener("change", () => {
  openFiles(input("file").files ?? []);
  input("file").value = "";
});
get("save").addEventListener("click", () => openSaving(wire, () => /** @type {Scene} */ (model.scene), view.canvas, complain));
get("share").addEventListener("click", () => openLinking(wire, /** @type {Scene} */ (model.scene)).catch(complain));
get("help").addEventListener("click", openTour);
get("toast").addEventListener("click", () => { get("toast").hidden = true; });
addEventListener("hashchange", followLink);
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  if (event.dataTransfer?.files.length && tools.canDraw) openFiles(event.dataTransfer.files);
});
addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || !tools.canDraw) return;
  const key = event.key.toLowerCase();
  if (key === "z" && !event.shiftKey) model.undo();
  else if (key === "y" || key === "z") model.redo();
  else return;
  event.preventDefault();
});
for (const kind of /** @type {const} */ (["pointerdown", "pointermove"])) {
  view.canvas.addEventListener(kind, (event) => {
    hoveredPoint = event.buttons && tools.tool !== "look" ? null : view.scene && view.pointOf(event);
    hovered = hoveredPoint && hoveredPoint.map(Math.floor);
    probing.want();
  });
}
view.canvas.addEventListener("pointerleave", (event) => {
  if (event.pointerType === "touch" && tools.tool === "look") return;
  hovered = null;
  probing.want();
});
view.canvas.addEventListener("walk", (event) => { hovered = /** @type {CustomEvent} */ (event).detail; hoveredPoint = null; probing.want(); });

/** @param {string} theme */
function dress(theme) {
  document.documentElement.dataset.theme = theme;
  view.dark = theme === "dark";
  view.refresh();
}
get("theme").addEventListener("click", () => {
  const theme = view.dark ? "light" : "dark";
  localStorage.setItem(THEME, theme);
  dress(theme);
});
const wanted = switches.get("theme") ?? localStorage.getItem(THEME);
dress(wanted ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
if (matchMedia("(prefers-reduced-motion: reduce)").matches) {
  view.shows.dots = false;
  input("show-dots").checked = false;
}
paintBar(/** @type {HTMLCanvasElement} */ (get("legend-bar")));
tell("busy", "connecting …");
wire.connect();
