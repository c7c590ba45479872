// Opening, saving and links.

import { centreOf, writeScene } from "./model.js";

/** @typedef {import("./model.js").Scene} Scene */
/** @typedef {import("./parts.js").Parts} Parts */
/** @typedef {import("./wire.js").Wire} Wire */

const LONG_LINK = 8192;
const CHOICES = [
  ["toml", "Scene", "TOML, for resgrid run and you"],
  ["png", "Picture", "PNG, as it is on the screen"],
  ["svg", "Drawing", "SVG, as rg.draw draws it"],
  ["circuit", "Circuit", "SVG, up to 10 × 10 cells"],
  ["csv", "Paths", "CSV, certified, world coordinates"],
  ["deck", "SPICE deck", "with its sidecar and check, zipped"],
];

/** @param {string} name @param {Blob | Uint8Array} content */
function download(name, content) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content instanceof Blob ? content : new Blob([/** @type {BlobPart} */ (content)]));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/** @param {Wire} wire @param {Scene} scene @param {string} format */
async function saved(wire, scene, format) {
  const [drawing, body] = writeScene(scene);
  const [head, content] = await wire.ask({ type: "save", format, drawing }, body);
  return /** @type {[string, Uint8Array]} */ ([head.name, content.slice()]);
}

/** A dialog with buttons. @param {Parts} parts @param {string} id @param {string} title */
function dialogOf({ get }, id, title) {
  const dialog = /** @type {HTMLDialogElement} */ (get(id));
  dialog.innerHTML = `<h2>${title}</h2><div class="body"></div><div class="actions"><button data-close>Close</button></div>`;
  dialog.querySelector("[data-close]")?.addEventListener("click", () => dialog.close());
  return { dialog, body: /** @type {HTMLElement} */ (dialog.querySelector(".body")), actions: /** @type {HTMLElement} */ (dialog.querySelector(".actions")) };
}

/** An empty grid like the one shown, or a square. @param {Scene} scene @param {number} [cells] @returns {Scene} */
function emptied(scene, cells) {
  const square = (/** @type {string} */ name) => ({ name, lower: 0, upper: Number(cells), cells: Number(cells), periodic: false, unit: "cell" });
  const axes = cells ? [square("x"), square("y")] : scene.axes, edge = cells ? ["obstacle", "obstacle"] : scene.edge;
  const [nx, ny] = axes.map((axis) => axis.cells), goal = Math.floor(0.75 * nx) * ny + Math.floor(0.75 * ny);
  const starts = [centreOf({ ...scene, axes }, [Math.floor(0.2 * nx), Math.floor(0.2 * ny)])];
  return { ...scene, title: "Drawing", axes, edge, cells: new Uint8Array(nx * ny), palette: [1], goals: [[goal]], starts, broken: [], world: null };
}

/** @param {Parts} parts @param {import("./model.js").Model} model */
export function openNew(parts, model) {
  const { dialog, body } = dialogOf(parts, "saving", "An empty grid");
  body.className = "body choices";
  for (const cells of [undefined, 10, 32, 64, 96, 128, 192, 256]) {
    const button = document.createElement("button"), small = document.createElement("small");
    button.append(cells ? `${cells} × ${cells}` : "As it is", small);
    small.textContent = !cells ? "this grid without what is drawn" : cells === 10 ? "its circuit is drawn" : `${cells * cells} nodes`;
    button.addEventListener("click", () => {
      dialog.close();
      model.replace(emptied(/** @type {Scene} */ (model.scene), cells));
    });
    body.append(button);
  }
  dialog.showModal();
}

/** @param {Parts} parts @param {Wire} wire @param {() => Scene} scene @param {HTMLCanvasElement} canvas @param {(error: unknown) => void} complain */
export function openSaving(parts, wire, scene, canvas, complain) {
  const { dialog, body } = dialogOf(parts, "saving", "Save");
  body.className = "body choices";
  for (const [format, label, about] of CHOICES) {
    const button = document.createElement("button"), small = document.createElement("small");
    small.textContent = about;
    button.append(label, small);
    button.addEventListener("click", async () => {
      dialog.close();
      try {
        if (format === "png") canvas.toBlob((blob) => blob && download("resgrid.png", blob));
        else download(...await saved(wire, scene(), format));
      } catch (error) {
        complain(error);
      }
    });
    body.append(button);
  }
  dialog.showModal();
}

/** The link that holds a scene. @param {Wire} wire @param {Scene} scene @param {string} [address] of a page */
export async function linkOf(wire, scene, address = `${location.origin}${location.pathname}`) {
  const [, content] = await saved(wire, scene, "json");
  const packed = await through(new CompressionStream("deflate-raw"), content);
  let text = "";
  for (const byte of packed) text += String.fromCharCode(byte);
  const code = btoa(text).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");
  return `${address}#s=${code}`;
}

/** The document in a link's fragment; null if there is none. @param {string} fragment */
export async function documentIn(fragment) {
  const code = new URLSearchParams(fragment.replace(/^#/, "")).get("s");
  if (!code) return null;
  const text = atob(code.replaceAll("-", "+").replaceAll("_", "/"));
  const bytes = await through(new DecompressionStream("deflate-raw"), Uint8Array.from(text, (letter) => letter.charCodeAt(0)));
  return JSON.parse(new TextDecoder().decode(bytes));
}

/** @param {GenericTransformStream} stream @param {Uint8Array} bytes */
async function through(stream, bytes) {
  const piped = new Blob([/** @type {BlobPart} */ (bytes)]).stream().pipeThrough(stream);
  return new Uint8Array(await new Response(piped).arrayBuffer());
}

/** @param {Parts} parts @param {Wire} wire @param {Scene} scene @param {string} [address] */
export async function openLinking(parts, wire, scene, address) {
  const link = await linkOf(wire, scene, address);
  const { dialog, body, actions } = dialogOf(parts, "linking", "A link that holds the whole scene");
  const field = document.createElement("input"), note = document.createElement("p"), copy = document.createElement("button");
  field.type = "text";
  field.readOnly = true;
  field.value = link;
  field.id = "link";
  const long = link.length > LONG_LINK ? " That is long for a link: a saved scene travels better." : "";
  note.className = "note";
  note.textContent = `${(link.length / 1024).toFixed(1)} kB; it is never sent to a server. 'resgrid run LINK' takes it, too.${long}`;
  copy.textContent = "Copy";
  copy.addEventListener("click", async () => {
    field.select();
    await navigator.clipboard?.writeText(link).catch(() => document.execCommand("copy"));
    copy.textContent = "Copied";
  });
  body.append(field, note);
  actions.prepend(copy);
  dialog.showModal();
  field.select();
}

/** Files as the server takes them. @param {Iterable<File>} files */
export async function contentsOf(files) {
  return Promise.all([...files].map(async (file) => {
    const url = await new Promise((resolve, reject) => {
      const reader = new FileReader();
      reader.onload = () => resolve(reader.result);
      reader.onerror = () => reject(reader.error);
      reader.readAsDataURL(file);
    });
    return { name: file.name, data: String(url).split(",", 2)[1] ?? "" };
  }));
}
