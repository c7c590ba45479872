// The connection to the server: requests with replies; of several scenes to solve, only the newest is sent.

import { writeScene } from "./model.js";

const RETRY_MS = [250, 500, 1000, 2000];

/** @param {object} head @param {Uint8Array} [body] */
function pack(head, body = new Uint8Array()) {
  const text = new TextEncoder().encode(JSON.stringify(head));
  const message = new Uint8Array(4 + text.length + body.length);
  new DataView(message.buffer).setUint32(0, text.length, true);
  message.set(text, 4);
  message.set(body, 4 + text.length);
  return message;
}

/** @param {ArrayBuffer} message @returns {[any, Uint8Array]} */
function unpack(message) {
  const size = new DataView(message).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(message, 4, size)));
  return [head, new Uint8Array(message, 4 + size)];
}

/** The part of the interface of a WebSocket that the page uses; also implemented for a notebook's comm.
 * @typedef {Pick<WebSocket, "send" | "readyState" | "binaryType" | "onmessage" | "onclose">} Socket */

export class Wire {
  #seq = 0;
  #attempt = 0;
  /** @type {Socket | null} */ #socket = null;
  /** @type {Map<number, {resolve: Function, reject: Function}>} */ #waiting = new Map();

  /** @param {() => Socket} dial @param {{hello: (head: any, body: Uint8Array) => void, lost: () => void}} hears */
  constructor(dial, hears) {
    this.dial = dial;
    this.hears = hears;
  }

  get isOpen() {
    return this.#socket?.readyState === 1;
  }

  connect() {
    const socket = this.dial();
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => this.#receive(event.data);
    socket.onclose = (event) => this.#lose(event);
    this.#socket = socket;
  }

  /** Send a request, with or without a scene, and return its reply.
   * @param {object} head @param {import("./model.js").Scene} [scene] @returns {Promise<[any, Uint8Array]>} */
  ask(head, scene) {
    if (!this.isOpen) return Promise.reject(new Error("the server does not answer; the drawing is kept"));
    const seq = ++this.#seq, [drawing, body] = scene ? writeScene(scene) : [undefined, undefined];
    return new Promise((resolve, reject) => {
      this.#waiting.set(seq, { resolve, reject });
      this.#socket?.send(pack({ ...head, drawing, seq }, body));
    });
  }

  /** @param {ArrayBuffer} message */
  #receive(message) {
    const [head, body] = unpack(message);
    if (head.hello) {
      this.#attempt = 0;
      this.hears.hello(head, body);
      return;
    }
    const waiting = this.#waiting.get(head.seq);
    this.#waiting.delete(head.seq);
    if (head.error) waiting?.reject(new Error(head.error));
    else waiting?.resolve([head, body]);
  }

  /** @param {{code: number}} event */
  #lose(event) {
    const why = event.code === 1009 ? "this drawing is too large for the server; use a smaller grid" : "the server does not answer";
    for (const { reject } of this.#waiting.values()) reject(new Error(why));
    this.#waiting.clear();
    this.hears.lost();
    setTimeout(() => this.connect(), RETRY_MS[Math.min(this.#attempt++, RETRY_MS.length - 1)]);
  }
}

/** Return a function that runs `ask`, one call at a time; calls during a run cause one more run afterwards.
 * @param {() => Promise<void>} ask */
export function newest(ask) {
  let isWanted = false;
  /** @type {Promise<void> | null} */ let asking = null;
  const run = async () => {
    try {
      while (isWanted) {
        isWanted = false;
        await ask();
      }
    } finally {
      asking = null;
    }
  };
  return () => {
    isWanted = true;
    asking ??= run();
    return asking;
  };
}
