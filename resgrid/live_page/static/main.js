// The page in a browser tab, served by `resgrid live`.

import { Page } from "./page.js";

const root = /** @type {HTMLElement} */ (document.getElementById("page"));
const live = new Page(root, () => new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`), {
  switches: new URLSearchParams(location.search),
  shelf: localStorage,
  keys: window,
  fragment: location.hash,
  address: `${location.origin}${location.pathname}`,
});
live.model.addEventListener("change", () => { document.title = `${live.model.scene?.title || "Drawing"} – resgrid live`; });
addEventListener("hashchange", () => live.follow(location.hash));
Object.assign(window, { live });
