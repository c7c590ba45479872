// Dialogs for opening, saving and links.

import { choicesOf, make } from "./layout.js";
import { base64, bytesIn, centreOf } from "./model.js";

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {import("./layout.js").Parts} Parts */
/** @typedef {import("./wire.js").Wire} Wire */

const LONG_LINK = 8192;
const CHOICES = [
  ["toml", "Scene", "TOML, for resgrid run"],
  ["png", "Picture", "PNG of the screen"],
  ["svg", "Drawing", "SVG, drawn by rg.draw"],
  ["circuit", "Circuit", "SVG, up to 10 × 10 cells"],
  ["csv", "Paths", "CSV, certified, world coordinates"],
  ["deck", "SPICE deck", "ZIP, with expected voltages"],
];

/** @param {string} name @param {Blob} content */
function download(name, content) {
  const link = make("a", { href: URL.createObjectURL(content), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/** Return an empty square grid, or the scene without obstacles. @param {Scene} scene @param {number | null} cells @returns {Partial<Scene>} */
function emptied(scene, cells) {
  const square = (/** @type {string} */ name) => ({ name, lower: 0, upper: Number(cells), cells: Number(cells), periodic: false, unit: "cell" });
  const axes = cells ? [square("x"), square("y")] : scene.axes, edge = cells ? ["obstacle", "obstacle"] : scene.edge;
  const [nx, ny] = axes.map((axis) => axis.cells), goal = Math.floor(0.75 * nx) * ny + Math.floor(0.75 * ny);
  const starts = [centreOf({ ...scene, axes }, [Math.floor(0.2 * nx), Math.floor(0.2 * ny)])];
  return { title: "Drawing", axes, edge, cells: new Uint8Array(nx * ny), palette: [1], goals: [[goal]], starts, broken: [], world: null };
}

/** @param {Parts} parts @param {import("./model.js").Model} model */
export function openNew({ open }, model) {
  const begin = (/** @type {number | null} */ cells) => () => {
    dialog.close();
    model.replace(emptied(/** @type {Scene} */ (model.scene), cells));
  };
  const dialog = open("saving", "An empty grid", choicesOf([
    ["Same size", "this grid without obstacles", begin(null)],
    ["10 × 10", "with its circuit", begin(10)],
    ...[32, 64, 96, 128, 192, 256].map((n) => /** @type {[string, string, () => void]} */ ([`${n} × ${n}`, `${n * n} nodes`, begin(n)])),
  ]));
}

/** @param {Parts} parts @param {Wire} wire @param {Scene} scene @param {(error: unknown) => void} complain */
export function openSaving({ open, canvas }, wire, scene, complain) {
  const save = async (/** @type {string} */ format) => {
    dialog.close();
    if (format === "png") return canvas("canvas").toBlob((blob) => blob && download("resgrid.png", blob));
    const [{ name }, content] = await wire.ask({ type: "save", format }, scene);
    return download(name, new Blob([/** @type {BlobPart} */ (content)]));
  };
  const dialog = open("saving", "Save", choicesOf(CHOICES.map(([format, label, about]) => [label, about, () => save(format).catch(complain)])));
}

/** Return a link that contains a scene. @param {Wire} wire @param {Scene} scene @param {string} [address] of a page */
export async function linkOf(wire, scene, address = `${location.origin}${location.pathname}`) {
  const [, content] = await wire.ask({ type: "save", format: "json" }, scene);
  const code = base64(await through(new CompressionStream("deflate"), content));
  return `${address}#s=${code.replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "")}`;
}

/** Return the document in a link's fragment; null without a document. @param {string} fragment */
export async function documentIn(fragment) {
  const code = new URLSearchParams(fragment.replace(/^#/, "")).get("s");
  if (!code) return null;
  const packed = bytesIn(code.replaceAll("-", "+").replaceAll("_", "/"));
  return JSON.parse(new TextDecoder().decode(await through(new DecompressionStream("deflate"), packed)));
}

/** @param {GenericTransformStream} stream @param {Uint8Array} bytes */
async function through(stream, bytes) {
  const piped = new Blob([/** @type {BlobPart} */ (bytes)]).stream().pipeThrough(stream);
  return new Uint8Array(await new Response(piped).arrayBuffer());
}

/** @param {Parts} parts @param {Wire} wire @param {Scene} scene @param {string} address */
export async function openLinking({ open }, wire, scene, address) {
  const link = await linkOf(wire, scene, address), field = make("input", { id: "link", readOnly: true, value: link });
  const long = link.length > LONG_LINK ? " This is long for a link; consider saving the scene instead." : "";
  const about = `${(link.length / 1024).toFixed(1)} kB; the scene in it is never sent to a server. 'resgrid run LINK' also accepts it.${long}`;
  const copy = make("button", { textContent: "Copy" });
  copy.addEventListener("click", async () => {
    field.select();
    await navigator.clipboard?.writeText(link).catch(() => document.execCommand("copy"));
    copy.textContent = "Copied";
  });
  open("linking", "A link that contains the scene", make("div", {}, field, make("p", { className: "note", textContent: about })), copy);
  field.select();
}

/** Return names and contents of files in the form of a request. @param {File[]} files */
export const contentsOf = (files) => Promise.all(files.map(async (file) => ({
  name: file.name, data: base64(new Uint8Array(await file.arrayBuffer())),
})));
