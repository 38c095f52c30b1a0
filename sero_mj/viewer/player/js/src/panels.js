/**
 * Shows trees of widgets as HTML elements. The server sends the nodes of a panel, and receives user input.
 *
 * The server sends a tree again whenever it has changed. Elements of widgets that still exist are
 * reused, so that focus, text cursor, scroll position and open lists do not change.
 */

import { WIDGETS } from "./widgets.js";
import { made } from "./page.js";

/** @typedef {import("./widgets.js").Node} Node */
/** @typedef {import("./widgets.js").Widget} Widget */

/**
 * The context of the widgets of a tree.
 * @typedef {{send: (message: object) => void, list: (room: HTMLElement) => List}} Context
 */

/** Returns the keys of nodes, which consist of kind and id, or of kind and number without an id. @param {Node[]} nodes */
export function keysOf(nodes) {
  /** @type {Record<string, number>} */
  const counts = {};
  return nodes.map(({ k, id }) => {
    if (id !== undefined) return `${k}:${id}`;
    counts[k] = (counts[k] ?? 0) + 1;
    return `${k}#${counts[k]}`;
  });
}

/** Returns the nodes of each line. @param {Node[]} nodes */
export function linesOf(nodes) {
  /** @type {number[][]} */
  const lines = [];
  nodes.forEach(({ same }, k) => {
    if (same !== undefined && same !== false && lines.length) lines[lines.length - 1].push(k);
    else lines.push([k]);
  });
  return lines;
}

/**
 * Makes elements the children of another element, in this order. Only elements in a wrong order are moved.
 * @param {HTMLElement} room @param {HTMLElement[]} wanted
 */
export function arrange(room, wanted) {
  const stay = new Set(wanted);
  for (const each of [...room.children]) if (!stay.has(/** @type {HTMLElement} */ (each))) each.remove();
  let next = room.firstElementChild;
  for (const each of wanted) {
    if (each === next) next = next.nextElementSibling;
    else room.insertBefore(each, next);
  }
}

/** Shows the nodes of one level of a tree. */
class List {
  /** @param {HTMLElement} room @param {Context} context */
  constructor(room, context) {
    this.room = room;
    this.context = context;
    /** @type {Map<string, Widget>} */
    this.widgets = new Map();
    /** @type {Map<string, HTMLElement>} */
    this.lines = new Map();
  }

  /** @param {Node[]} nodes */
  update(nodes) {
    const keys = keysOf(nodes), before = this.widgets;
    this.widgets = new Map();
    nodes.forEach((node, k) => {
      const make = WIDGETS[node.k];
      if (!make) return;
      const widget = before.get(keys[k]) ?? make(node, this.context);
      before.delete(keys[k]);
      widget.update(node);
      this.widgets.set(keys[k], widget);
    });
    for (const widget of before.values()) widget.dispose?.();
    const lines = new Map();
    for (const line of linesOf(nodes)) {
      const shown = line.filter((k) => this.widgets.has(keys[k])), key = keys[line[0]];
      if (!shown.length) continue;
      const element = this.lines.get(key) ?? made("div", "", { class: "line" });
      arrange(element, shown.map((k) => this.#element(keys[k])));
      place(shown.map((k) => nodes[k]), shown.map((k) => /** @type {Widget} */ (this.widgets.get(keys[k]))));
      lines.set(key, element);
    }
    this.lines = lines;
    arrange(this.room, [...lines.values()]);
  }

  /** @param {string} key */
  #element(key) { return /** @type {Widget} */ (this.widgets.get(key)).element; }

  /** Disposes of the widgets. */
  dispose() {
    for (const widget of this.widgets.values()) widget.dispose?.();
  }
}

/** Sets the widths and left edges of the widgets in a line. @param {Node[]} nodes @param {Widget[]} widgets */
function place(nodes, widgets) {
  let begin = 0; // left edge of the previous widget, em
  nodes.forEach(({ width, same, left }, k) => {
    const { element, sized = element } = widgets[k];
    element.classList.toggle("rest", width === 0);
    // The label of a button may need more width than in windows.
    sized.style[element.tagName === "BUTTON" ? "minWidth" : "width"] = width ? `${width}em` : "";
    element.style.marginLeft = typeof same === "number" && same > 0 ? `${same}em` : "";
    if (!left) return;
    widgets[k - 1]?.element.style.setProperty("min-width", `calc(${left - begin}em - var(--gap))`);
    begin = left;
  });
}

/** Shows a tree of widgets in an element. */
export class Tree {
  /**
   * @param {HTMLElement} room @param {string} name of the tree in messages
   * @param {(message: object) => void} send
   */
  constructor(room, name, send) {
    /** @type {Context} */
    const context = {
      send: (message) => send({ ...message, tree: name }),
      list: (own) => new List(own, context),
    };
    this.list = new List(room, context);
  }

  /** @param {Node[]} nodes */
  update(nodes) { this.list.update(nodes); }

  dispose() { this.list.dispose(); }
}
