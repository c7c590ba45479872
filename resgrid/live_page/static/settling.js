// Transients: pictures and voltages over time after the rails are switched on or after the last change, with a scope.

import { engineering } from "./circuit.js";
import { cellAt, numberOf } from "./model.js";
import { Scope } from "./scope.js";

/** @typedef {{times: number[], pictures: Uint16Array[], volts: Float32Array[]}} Film */

const PLAY_MS = 2500;

export class Settling {
  /** @type {Film | null} */ #film = null;
  #playing = 0;
  #number = 0;
  /** The cell under the pointer. @type {number[] | null} */ #pointed = null;
  /** The cell that was clicked with the tool Look. @type {number[] | null} */ #pinned = null;

  /** @param {import("./layout.js").Parts} parts @param {import("./model.js").Model} model @param {import("./wire.js").Wire} wire
   * @param {import("./view.js").View} view
   * @param {{complain: (error: unknown) => void, moved: () => void}} calls `moved`: called when another time is shown */
  constructor({ get, input, canvas }, model, wire, view, { complain, moved }) {
    this.get = get;
    this.input = input;
    this.model = model;
    this.view = view;
    this.moved = moved;
    this.scope = new Scope(canvas("scope"));
    get("settle").addEventListener("click", () => this.#fetch(wire).catch(complain));
    get("play").addEventListener("click", () => this.#play(performance.now()));
    input("moment").addEventListener("input", () => {
      cancelAnimationFrame(this.#playing);
      this.#show(Number(input("moment").value));
    });
    view.canvas.addEventListener("pin", (event) => this.#pin(/** @type {CustomEvent} */ (event).detail));
  }

  /** Remove the transient after a change of scene or field. */
  clear() {
    if (this.#film) {
      cancelAnimationFrame(this.#playing);
      this.#film = null;
      this.get("film").hidden = true;
      this.view.setMoment(null);
    }
    if (this.#pinned && this.#pinned.some((part, a) => part >= (this.model.scene?.axes[a].cells ?? 0))) this.#pin(this.#pinned);
  }

  /** Set the cell under the pointer. @param {number[] | null} cell */
  point(cell) {
    this.#pointed = cell;
    this.refresh();
  }

  /** Return time, volts and logarithm of the drop of a cell at the time shown; null for the steady-state field.
   * @param {number[]} cell */
  at(cell) {
    const film = this.#film, { scene, view: { frame } } = { scene: this.model.scene, view: this.view };
    if (!film || !scene || !frame || this.#number === film.times.length - 1) return null;
    const number = numberOf(scene, cell), { kind, low, high } = frame.scale, fraction = film.pictures[this.#number][number] / 65534;
    return {
      time: film.times[this.#number],
      volts: film.volts[this.#number][number],
      decades: kind === "decades" && fraction <= 1 ? low + fraction * (high - low) : null,
    };
  }

  /** Pin a cell to the scope, or unpin it. @param {number[]} cell */
  #pin(cell) {
    const isSame = this.#pinned?.every((part, a) => part === cell[a]);
    this.#pinned = this.view.pinned = isSame ? null : cell;
    this.refresh();
  }

  /** @param {import("./wire.js").Wire} wire */
  async #fetch(wire) {
    const { scene } = this.model, button = this.input("settle");
    if (!scene) return;
    button.disabled = true;
    button.textContent = "computing the transient …";
    try {
      const [{ times, from_rest: isFromRest }, { buffer, byteOffset }] = await wire.ask({ type: "settle" }, scene);
      if (scene !== this.model.scene || !this.view.frame) return;
      const cells = scene.cells.length, then = byteOffset + 2 * cells * times.length;
      const pictures = times.map((/** @type {number} */ _, /** @type {number} */ n) => new Uint16Array(buffer, byteOffset + 2 * n * cells, cells));
      const volts = new Float32Array(buffer.slice(then, then + 4 * cells * times.length));
      this.#film = { times, pictures, volts: times.map((/** @type {number} */ _, /** @type {number} */ n) => volts.subarray(n * cells, (n + 1) * cells)) };
      this.get("film").hidden = false;
      this.get("origin").textContent = isFromRest ? "rails switched on at 0 V" : "from the field before the last change";
      this.input("moment").max = String(pictures.length - 1);
      this.#play(performance.now());
    } catch (error) {
      if (scene === this.model.scene) throw error; // errors of an earlier drawing are irrelevant
    } finally {
      button.disabled = false;
      button.textContent = "Show transient";
    }
  }

  /** @param {number} began */
  #play(began) {
    if (!this.#film) return;
    cancelAnimationFrame(this.#playing);
    const last = this.#film.times.length - 1, at = Math.min(last, Math.floor(((performance.now() - began) / PLAY_MS) * (last + 1)));
    this.#show(at);
    if (at < last) this.#playing = requestAnimationFrame(() => this.#play(began));
  }

  /** @param {number} number */
  #show(number) {
    const film = this.#film;
    if (!film) return;
    const isLast = number === film.times.length - 1;
    this.#number = number;
    this.input("moment").value = String(number);
    this.get("time").textContent = isLast ? `${engineering(film.times[number], "s", 3)}: settled` : engineering(film.times[number], "s", 3);
    this.view.setMoment(isLast ? null : { picture: film.pictures[number] });
    this.refresh();
    this.moved();
  }

  /** Draw the voltages of the cell under the pointer and of the pinned cell, or of the first start. */
  refresh() {
    const film = this.#film, { scene } = this.model;
    if (!film || !scene) return;
    const [start] = scene.starts, cells = [this.#pointed, this.#pinned].filter((cell) => cell !== null);
    if (!cells.length && start) cells.push(cellAt(scene, start));
    const curves = cells.map((cell) => {
      const number = numberOf(scene, cell);
      return { name: `cell ${cell.join(", ")}`, volts: film.volts.map((volts) => volts[number]) };
    });
    this.scope.show({ times: film.times, curves, at: this.#number, dark: this.view.dark });
  }
}
