// The parts of a page by their names, within its own root: a notebook may show several pages.

/** @param {ParentNode} root */
export const partsOf = (root) => ({
  /** @param {string} id */
  get: (id) => /** @type {HTMLElement} */ (root.querySelector(`#${id}`)),
  /** @param {string} id */
  input: (id) => /** @type {HTMLInputElement} */ (root.querySelector(`#${id}`)),
});

/** @typedef {ReturnType<typeof partsOf>} Parts */
