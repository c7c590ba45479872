// The HTML of a page, and access to its elements by id within the page: a notebook may show several pages.

export const HTML = `
<header>
  <h1>resgrid</h1>
  <span id="title"></span>
  <span class="buttons">
    <button id="examples" title="Open an example; the drawing stays in the undo history" aria-haspopup="dialog">Examples</button>
    <button id="undo" title="Undo (Ctrl+Z)" aria-label="Undo">&#8630;</button>
    <button id="redo" title="Redo (Ctrl+Shift+Z)" aria-label="Redo">&#8631;</button>
    <button id="new" title="Start with an empty grid">New</button>
    <button id="clear" title="Remove all drawn obstacles; keep goals, starts and mud">Clear walls</button>
    <button id="open" title="Open a scene or a map, or drop files on the page">Open</button>
    <button id="save" title="Save a scene, a picture, a table or a deck">Save</button>
    <button id="share" title="Show a link that contains the scene">Link</button>
    <button id="theme" title="Dark or light" aria-label="Dark or light">&#9680;</button>
    <button id="help" title="Help" aria-label="Help">?</button>
  </span>
  <input id="file" type="file" multiple hidden accept=".toml,.yaml,.yml,.map,.png,.pgm,.jpg,.jpeg,.bmp">
</header>
<main>
  <div id="tools" role="toolbar" aria-label="Tools"></div>
  <div id="stage">
    <div id="boards">
      <canvas id="canvas" tabindex="0" aria-label="The grid. Arrow keys move the cursor, space uses the tool."></canvas>
      <canvas id="world" tabindex="0" aria-label="The arm's workspace: drag obstacles and goals. Space selects an object, arrow keys move it."></canvas>
    </div>
    <div id="film" hidden>
      <div class="row"><button id="play" title="Play again" aria-label="Play again">&#9654;</button><span id="origin" class="note"></span><output id="time"></output></div>
      <canvas id="scope" aria-label="Voltage over time of the cell under the pointer"></canvas>
      <input id="moment" type="range" min="0" aria-label="Time">
    </div>
    <div id="below"><span id="quality" role="status"></span><span id="legend"><span id="legend-cut" hidden>no path to a goal</span><span id="legend-low"></span><span id="legend-bar"></span><span id="legend-high"></span></span></div>
  </div>
  <aside id="panel"></aside>
  <div id="card" hidden></div>
</main>
<dialog id="tour"></dialog>
<dialog id="choosing" aria-label="Examples"></dialog>
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
  /** Show a dialog with a body and buttons below. @param {string} id @param {string} title @param {Node} body @param {Node[]} actions */
  open: (id, title, body, ...actions) => {
    const dialog = /** @type {HTMLDialogElement} */ (root.querySelector(`#${id}`));
    const close = make("button", { textContent: "Close", autofocus: true, onclick: () => dialog.close() });
    dialog.replaceChildren(make("h2", { textContent: title }), body, make("div", { className: "actions" }, ...actions, close));
    if (!dialog.open) dialog.showModal();
    return dialog;
  },
});

/** @typedef {ReturnType<typeof partsOf>} Parts */

/** Return a new element. @template {keyof HTMLElementTagNameMap} T @param {T} tag @param {Record<string, unknown>} properties @param {(Node | string)[]} children */
export function make(tag, properties, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

/** Return a group of buttons. @param {[string, string, () => void][]} choices label, explanation and action of each button */
export const choicesOf = (choices) => make("div", { className: "choices" }, ...choices.map(([label, about, onclick]) => (
  make("button", { onclick }, label, make("small", { textContent: about })))));

const SENTENCES = [
  "Every cell is a node of a resistor grid: obstacles are tied to one voltage rail, goals to the other, and current flows between them.",
  "Dots move along the current. A robot that follows the current reaches a goal, because the potential has no other local minimum.",
  "Draw walls, and drag the goal (red) and the starts (white): the circuit is solved again while you draw.",
  "With k = 1 paths keep away from obstacles, with k = 0 (open obstacles) they touch them; colours show the potential drop.",
  "After every change the field is solved until the current is right in every cell; ✓ means that the paths are certified.",
];

/** Show five sentences that explain the page. @param {Parts} parts @param {string} keys of the tools */
export function openTour({ open }, keys) {
  const about = `Keys: ${keys} select tools, arrows move the cursor, space applies the tool, shift + arrows move a goal or start, Ctrl+Z undoes.`;
  const list = make("ol", {}, ...SENTENCES.map((textContent) => make("li", { textContent })));
  open("tour", "A circuit that plans paths", make("div", {}, list, make("p", { className: "note", textContent: about })));
}
