// What a page consists of, and its parts by their names: a notebook may show several pages.

export const HTML = `
<header>
  <h1>resgrid</h1>
  <label class="examples">Scene <select id="examples"></select></label>
  <span class="buttons">
    <button id="undo" title="Undo (Ctrl+Z)" aria-label="Undo">&#8630;</button>
    <button id="redo" title="Redo (Ctrl+Shift+Z)" aria-label="Redo">&#8631;</button>
    <button id="new" title="An empty grid of some size">New</button>
    <button id="open" title="A scene or a map; or drop files on the page">Open</button>
    <button id="save" title="As a scene, a picture, a deck, a table">Save</button>
    <button id="share" title="A link that holds the whole scene">Link</button>
    <button id="theme" title="Dark or light" aria-label="Dark or light">&#9680;</button>
    <button id="help" title="What is this?" aria-label="What is this?">?</button>
  </span>
  <input id="file" type="file" multiple hidden accept=".toml,.yaml,.yml,.map,.png,.pgm,.jpg,.jpeg,.bmp">
</header>
<main>
  <div id="tools" role="toolbar" aria-label="Tools"></div>
  <div id="stage">
    <div id="boards">
      <canvas id="canvas" tabindex="0" aria-label="The grid. Arrow keys move the cursor, space uses the tool."></canvas>
      <canvas id="world" tabindex="0" aria-label="The arm's workspace: drag what stands there. Space chooses a thing, arrow keys move it."></canvas>
    </div>
    <div id="film" hidden>
      <div class="row"><button id="play" title="Play again" aria-label="Play again">&#9654;</button><span id="origin" class="note"></span><output id="time"></output></div>
      <canvas id="scope" aria-label="Voltage over time of the cell under the pointer"></canvas>
      <input id="moment" type="range" min="0" aria-label="Moment">
    </div>
    <div id="below"><span id="quality" role="status"></span><span id="legend"><span id="legend-cut" hidden>no way to a goal</span><span id="legend-low"></span><span id="legend-bar"></span><span id="legend-high"></span></span></div>
  </div>
  <aside id="panel"></aside>
  <div id="card" hidden></div>
</main>
<dialog id="tour"></dialog>
<dialog id="saving"></dialog>
<dialog id="linking"></dialog>
<div id="toast" role="alert" hidden></div>`;

/** @param {ParentNode} root */
export const partsOf = (root) => ({
  /** @param {string} id */
  get: (id) => /** @type {HTMLElement} */ (root.querySelector(`#${id}`)),
  /** @param {string} id */
  input: (id) => /** @type {HTMLInputElement} */ (root.querySelector(`#${id}`)),
  /** @param {string} id */
  canvas: (id) => /** @type {HTMLCanvasElement} */ (root.querySelector(`#${id}`)),
  /** A dialog with something in it and buttons below; it is shown. @param {string} id @param {string} title @param {Node} body @param {Node[]} actions */
  open: (id, title, body, ...actions) => {
    const dialog = /** @type {HTMLDialogElement} */ (root.querySelector(`#${id}`));
    const close = make("button", { textContent: "Close", autofocus: true, onclick: () => dialog.close() });
    dialog.replaceChildren(make("h2", { textContent: title }), body, make("div", { className: "actions" }, ...actions, close));
    if (!dialog.open) dialog.showModal();
    return dialog;
  },
});

/** @typedef {ReturnType<typeof partsOf>} Parts */

/** An element. @template {keyof HTMLElementTagNameMap} T @param {T} tag @param {Record<string, unknown>} properties @param {(Node | string)[]} children */
export function make(tag, properties, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/** Buttons of which one is chosen. @param {[string, string, () => void][]} choices label, what it means, and what it does */
export const choicesOf = (choices) => make("div", { className: "choices" }, ...choices.map(([label, about, onclick]) => (
  make("button", { onclick }, label, make("small", { textContent: about })))));

const SENTENCES = [
  "Every cell is a node of a grid of resistors: obstacles are tied to one rail, goals to the other, and current runs between them.",
  "The dots drift along that current, and a robot that follows it reaches a goal: the potential has no other place to rest.",
  "Draw walls, drag the goal (red) and the starts (white): the circuit is solved again while you draw.",
  "With k = 1 obstacles repel, with k = 0 they are open and paths graze them; colours show how far the potential has dropped.",
  "Let go, and the field is solved until every direction is safe; ✓ means that the path was then certified, step by step.",
];

/** Five sentences about what one sees. @param {Parts} parts @param {string} keys of the tools */
export function openTour({ open }, keys) {
  const about = `Keys: ${keys} choose tools, arrows move a cursor, space uses the tool, shift + arrows take a goal or start along, Ctrl+Z undoes.`;
  const list = make("ol", {}, ...SENTENCES.map((textContent) => make("li", { textContent })));
  open("tour", "A chip that plans paths", make("div", {}, list, make("p", { className: "note", textContent: about })));
}
