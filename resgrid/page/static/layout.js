// What a page consists of.

export const LAYOUT = `
<header>
  <h1>resgrid</h1>
  <label class="examples">Example <select id="examples"></select></label>
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
    <canvas id="canvas" tabindex="0" aria-label="The grid. Arrow keys move the cursor, space uses the tool."></canvas>
    <canvas id="world" tabindex="0" aria-label="The arm's workspace: drag what stands there. Space chooses a thing, arrow keys move it."></canvas>
    <div id="card" hidden></div>
    <div id="below"><span id="quality" role="status"></span><span id="legend"><span id="legend-low"></span><canvas id="legend-bar" width="160" height="8"></canvas><span id="legend-high"></span></span></div>
  </div>
  <aside id="panel"></aside>
</main>
<dialog id="tour"></dialog>
<dialog id="saving"></dialog>
<dialog id="linking"></dialog>
<div id="toast" role="alert" hidden></div>`;
