// How the potential came about: pictures of moments after the rails were switched on, or after the last change.

import { engineering } from "./circuit.js";

const PLAY_MS = 2500;

export class Settling {
  /** @type {{times: number[], pictures: Uint16Array[], scale: any} | null} */ #film = null;
  #playing = 0;

  /** @param {import("./layout.js").Parts} parts @param {import("./model.js").Model} model @param {import("./wire.js").Wire} wire
   * @param {import("./view.js").View} view @param {(error: unknown) => void} complain */
  constructor({ get, input }, model, wire, view, complain) {
    this.get = get;
    this.input = input;
    this.view = view;
    get("settle").addEventListener("click", () => this.#fetch(model, wire).catch(complain));
    input("moment").addEventListener("input", () => {
      cancelAnimationFrame(this.#playing);
      this.#show(Number(input("moment").value));
    });
  }

  /** Another scene or field: what was shown is past. */
  clear() {
    if (!this.#film) return;
    cancelAnimationFrame(this.#playing);
    this.#film = null;
    this.get("film").hidden = true;
    this.view.setMoment(null);
  }

  /** @param {import("./model.js").Model} model @param {import("./wire.js").Wire} wire */
  async #fetch(model, wire) {
    const { scene } = model, button = this.input("settle");
    if (!scene) return;
    button.disabled = true;
    try {
      const [{ times, scale, from_rest: isFromRest }, { buffer, byteOffset }] = await wire.ask({ type: "settle" }, scene);
      if (scene !== model.scene) return;
      const cells = scene.cells.length;
      const pictures = times.map((/** @type {number} */ _, /** @type {number} */ n) => new Uint16Array(buffer, byteOffset + 2 * n * cells, cells));
      this.#film = { times, pictures, scale };
      this.get("film").hidden = false;
      this.get("origin").textContent = isFromRest ? "from rest, rails switched on" : "from the field before the last change";
      this.input("moment").max = String(pictures.length - 1);
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
    this.input("moment").value = String(number);
    this.get("time").textContent = engineering(this.#film.times[number], "s");
    this.view.setMoment({ picture: this.#film.pictures[number], scale: this.#film.scale });
  }
}
