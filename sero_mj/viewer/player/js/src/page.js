/** Helpers for HTML elements. */

/** @template {Element} [T=HTMLElement] @param {string} id */
export const byId = (id) => /** @type {T} */ (/** @type {unknown} */ (document.getElementById(id)));

/** Returns the boxes of elements that are visible. @param {string[]} selectors */
export const boxesOf = (selectors) => selectors.flatMap((each) => [...document.querySelectorAll(each)])
  .filter((each) => each.getClientRects().length)
  .map((each) => each.getBoundingClientRect());

/**
 * Returns a new element.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag @param {string} text @param {Record<string, string>} [attributes]
 * @returns {HTMLElementTagNameMap[K]}
 */
export function made(tag, text, attributes = {}) {
  const element = document.createElement(tag);
  if (text) element.textContent = text;
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

/** Sets the text of an element if it has changed. @param {Element} element @param {string} text */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Sets an attribute if it has changed. @param {Element} element @param {string} name @param {string} value */
export function mark(element, name, value) {
  if (element.getAttribute(name) !== value) element.setAttribute(name, value);
}

/** @param {Event} event */
export const valueIn = (event) => /** @type {HTMLSelectElement} */ (event.target).value;
