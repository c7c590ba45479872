// The menu of examples: a dialog with a button per example, and the sentence on the example that is shown.

import { choicesOf, make } from "./layout.js";

/** @typedef {{name: string, title: string, about: string, group: string}} Example */

/** Show the examples by group. @param {import("./layout.js").Parts} parts @param {Example[]} examples @param {string} title of the current scene
 * @param {(name: string) => void} choose */
export function openExamples({ open }, examples, title, choose) {
  const groups = [...new Set(examples.map((example) => example.group))];
  const body = make("div", { className: "groups" }, ...groups.map((group) => {
    const own = examples.filter((example) => example.group === group);
    const buttons = choicesOf(own.map(({ name, title: label, about }) => [label, about, () => {
      dialog.close();
      choose(name);
    }]));
    own.forEach(({ name, title: label }, n) => {
      const button = /** @type {HTMLButtonElement} */ (buttons.children[n]);
      button.dataset.example = name;
      button.ariaCurrent = String(label === title);
    });
    return make("section", { ariaLabel: group }, make("h3", { textContent: group }), buttons);
  }));
  const dialog = open("choosing", "Examples", body), current = dialog.querySelector('[aria-current="true"]');
  /** @type {HTMLElement} */ (current ?? dialog.querySelector(".choices button")).focus();
}
