// The page as a notebook widget (anywidget): its session runs in the kernel, with messages over the widget's comm.

import { Page } from "./page.js";

const ADDRESS = "http://127.0.0.1:8017/", HEIGHT = "640px";

/** @typedef {{send: (content: object, callbacks?: object, buffers?: ArrayBufferView[]) => void,
 *   on: (name: string, call: Function) => void, off: (name: string, call: Function) => void}} Comm */

/** Return an object with the interface of a WebSocket for one view of a comm. @param {Comm} comm @param {string} view @param {AbortSignal} signal
 * @returns {import("./wire.js").Socket} */
function dial(comm, view, signal) {
  const receive = (/** @type {{view: string}} */ content, /** @type {DataView[]} */ [data]) => {
    if (content.view !== view) return;
    const message = new Uint8Array(data.buffer, data.byteOffset, data.byteLength).slice().buffer;
    socket.onmessage?.call(/** @type {WebSocket} */ (socket), new MessageEvent("message", { data: message }));
  };
  /** @type {import("./wire.js").Socket} */ const socket = {
    readyState: 1, binaryType: "arraybuffer", onmessage: null, onclose: null,
    send: (message) => comm.send({ view }, undefined, [/** @type {Uint8Array} */ (message)]),
  };
  comm.on("msg:custom", receive);
  signal.addEventListener("abort", () => {
    comm.off("msg:custom", receive);
    comm.send({ view, end: true });
  });
  comm.send({ view });
  return socket;
}

/** @param {{model: Comm, el: HTMLElement}} where @param {string} style */
export function show({ model, el }, style) {
  const shadow = el.attachShadow({ mode: "open" }), sheet = document.createElement("style"), root = document.createElement("div");
  const ending = new AbortController(), /** @type {Map<string, string>} */ kept = new Map([["resgrid tour", "1"]]);
  el.dataset.lmSuppressShortcuts = "true";
  el.style.cssText = `display: block; height: ${HEIGHT};`;
  sheet.textContent = style;
  root.className = "page";
  shadow.append(sheet, root);
  for (const kind of ["keydown", "keyup", "keypress"]) root.addEventListener(kind, (event) => event.stopPropagation());
  const page = new Page(root, () => dial(model, String(Math.random()), ending.signal), {
    switches: new URLSearchParams(),
    shelf: { getItem: (key) => kept.get(key) ?? null, setItem: (key, value) => { kept.set(key, value); } },
    keys: root,
    address: ADDRESS,
    fragment: "",
  });
  return () => {
    page.close();
    ending.abort();
  };
}
