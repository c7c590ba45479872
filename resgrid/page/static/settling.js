// How the potential came about: pictures of moments after the rails were switched on, or after the last change.

import { writeScene } from "./model.js";
import { engineering } from "./panel.js";

/** @typedef {import("./model.js").Scene} Scene */

const PLAY_MS = 2500;

export class Settling {
  /** @type {{times: number[], pictures: Uint16Array[], scale: any} | null} */ #film = null;
  #playing = 0;

  /** @param {import("./parts.js").Parts} parts @param {import("./model.js").Model} model @param {import("./wire.js").Wire} wire @param {import("./view.js").View} view
   * @param {(error: unknown) => void} complain */
  constructor(parts, model, wire, view, complain) {
    this.parts = parts;
    this.model = model;
    this.wire = wire;
    this.view = view;
    this.parts.get("settle").addEventListener("click", () => this.#fetch().catch(complain));
    this.parts.input("moment").addEventListener("input", () => {
      cancelAnimationFrame(this.#playing);
      this.#show(Number(this.parts.input("moment").value));
    });
  }

  /** Another scene or field: what was shown is past. */
  clear() {
    if (!this.#film) return;
    cancelAnimationFrame(this.#playing);
    this.#film = null;
    this.parts.get("film").hidden = true;
    this.view.setMoment(null);
  }

  async #fetch() {
    const scene = this.model.scene;
    if (!scene) return;
    const button = this.parts.input("settle");
    button.disabled = true;
    try {
      const [drawing, body] = writeScene(scene);
      const [head, bytes] = await this.wire.ask({ type: "settle", drawing }, body);
      if (scene !== this.model.scene) return;
      const cells = scene.cells.length, { buffer, byteOffset } = bytes;
      const pictures = head.times.map((/** @type {number} */ _, /** @type {number} */ n) => new Uint16Array(buffer, byteOffset + 2 * n * cells, cells));
      this.#film = { times: head.times, pictures, scale: head.scale };
      this.parts.get("film").hidden = false;
      this.parts.get("origin").textContent = head.from_rest ? "from rest, rails switched on" : "from the field before the last change";
      this.parts.input("moment").max = String(pictures.length - 1);
      this.#play(performance.now());
    } finally {
      button.disabled = false;
    }
  }

  /** @param {number} began */
  #play(began) {
    if (!this.#film) return;
    const last = this.#film.times.length - 1, at = Math.min(last, Math.floor(((performance.now() - began) / PLAY_MS) * (last + 1)));
    this.#show(at);
    if (at < last) this.#playing = requestAnimationFrame(() => this.#play(began));
  }

  /** @param {number} number */
  #show(number) {
    if (!this.#film) return;
    this.parts.input("moment").value = String(number);
    this.parts.get("time").textContent = engineering(this.#film.times[number], "s");
    this.view.setMoment({ picture: this.#film.pictures[number], scale: this.#film.scale });
  }
}
