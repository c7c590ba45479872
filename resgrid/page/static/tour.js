// Five sentences about what one sees.

const SENTENCES = [
  "Every cell is a node of a grid of resistors: obstacles are tied to one rail, goals to the other, and current runs between them.",
  "The dots drift along that current, and a robot that follows it reaches a goal: the potential has no other place to rest.",
  "Draw walls, drag the goal (orange) and the starts (white): the circuit is solved anew while you draw.",
  "With k = 1 obstacles repel, with k = 0 they are open and paths graze them; colours show how far the potential has dropped.",
  "Let go, and the field is solved until every direction is safe; ✓ means that the path was then certified, step by step.",
];

/** @param {import("./parts.js").Parts} parts */
export function openTour(parts) {
  const dialog = /** @type {HTMLDialogElement} */ (parts.get("tour"));
  dialog.innerHTML = `<h2>A chip that plans paths</h2><ol>${SENTENCES.map((text) => `<li>${text}</li>`).join("")}</ol>
    <p class="note">Keys: W E B F M G S X L choose tools, arrows move a cursor, space uses the tool, shift + arrows take a goal or start along, Ctrl+Z undoes.</p>
    <div class="actions"><button autofocus>Begin</button></div>`;
  dialog.querySelector("button")?.addEventListener("click", () => dialog.close());
  if (!dialog.open) dialog.showModal();
}
