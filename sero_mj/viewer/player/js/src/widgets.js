/** The kinds of widgets. Their elements are created once and then updated. */

import { Graph } from "./graph.js";
import { made, mark, write } from "./page.js";
import { Ticks } from "./ticks.js";

/**
 * A widget as sent by the server. Each kind has some of the keys.
 * @typedef {{k: string, id?: string, s?: string, aria?: string, tip?: string, off?: boolean,
 *   width?: number, same?: number | boolean, left?: number, mood?: string, open?: boolean,
 *   nodes?: Node[], widths?: number[], rows?: Node[][][], lit?: boolean, text?: string, hint?: string,
 *   on?: boolean, index?: number, names?: string[], value?: number, low?: number, high?: number,
 *   ticks?: Tick[], count?: number, height?: number, lines?: any[], x?: string, y?: string,
 *   xRange?: [number, number], yRange?: [number, number], limits?: number[], now?: number, name?: string}} Node
 */
/** @typedef {[at: number, kind: string, text: string, end?: number, label?: string]} Tick */
/** @typedef {{element: HTMLElement, sized?: HTMLElement, update: (node: Node) => void,
 *   graph?: Graph, dispose?: () => void}} Widget sized: element whose width is set (default: `element`) */
/** @typedef {import("./panels.js").Context} Context */

const ECHO = 1000; // maximum time until the server confirms a change, ms

/**
 * A value that the user can change. The user's value is shown until the server confirms it, and it is
 * not overwritten while the user changes it.
 * @template T
 */
export class Held {
  constructor() {
    /** @type {T | undefined} */
    this.wanted = undefined;
    this.since = -Infinity;
    this.isHeld = false;
  }

  /** Stores the value that the user has set. @param {T} value */
  set(value) {
    this.wanted = value;
    this.since = performance.now();
  }

  /** Returns the value to show for the value of the server. @param {T} value @returns {T} */
  shown(value) {
    if (this.wanted === undefined) return value;
    const isOver = this.wanted === value || performance.now() - this.since > ECHO;
    if (isOver && !this.isHeld) this.wanted = undefined;
    return this.wanted ?? value;
  }
}

const STEPS = 100; // minimum number of keyboard steps of a slider
const DRAGGED = 0.1; // step of a drag relative to a keyboard step
/** @type {Record<string, number>} */
const PLACES = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, PageUp: 10, PageDown: -10 };

/** Returns the step of a slider's keys, which is 1, 2 or 5 times a power of ten. @param {number} low @param {number} high */
export function stepOf(low, high) {
  const largest = (high - low) / STEPS || 1, power = 10 ** Math.floor(Math.log10(largest) + 1e-9);
  return power * ([5, 2].find((each) => each * power <= largest * (1 + 1e-9)) ?? 1);
}

/** Returns the multiple of a step that is nearest to a value. @param {number} value @param {number} step */
export function rounded(value, step) {
  const digits = Math.max(-Math.floor(Math.log10(step) + 1e-9), 0);
  return Number((Math.round(value / step) * step).toFixed(digits));
}

/** Sets the label and the tooltip of a control, and whether it is disabled. @param {HTMLElement} control @param {Node} node */
function common(control, { s, aria, hint, tip, off }) {
  const words = s ? "" : aria ?? hint ?? "";
  if (words) mark(control, "aria-label", words);
  if ("disabled" in control && control.disabled !== Boolean(off)) control.disabled = Boolean(off);
  explain(control, tip);
}

/** @param {HTMLElement} element @param {string} [tip] */
function explain(element, tip) {
  if (element.title !== (tip ?? "")) element.title = tip ?? "";
}

/** Creates an element with a control and a label beside it. @param {HTMLElement} control @param {string} kind */
function labelled(control, kind) {
  const element = made("label", "", { class: kind }), words = made("span", "");
  element.append(control, words);
  /** @param {Node} node */
  const describe = (node) => {
    words.hidden = !node.s;
    write(words, node.s ?? "");
    common(control, node);
  };
  return { element, describe };
}

/** Returns a function that creates a text. @param {keyof HTMLElementTagNameMap} tag @param {string} kind @returns {() => Widget} */
const words = (tag, kind) => () => {
  const element = /** @type {HTMLElement} */ (made(tag, ""));
  return { element, update: ({ s, mood, tip }) => {
    write(element, s ?? "");
    const look = `${kind} ${mood ?? ""}`;
    if (element.className !== look) element.className = look;
    explain(element, tip);
  } };
};

/** Returns a function that creates a collapsible section or tree node. @param {string} kind @returns {(node: Node, context: Context) => Widget} */
const folding = (kind) => ({ id }, { send, list }) => {
  const element = made("details", "", { class: kind }), summary = made("summary", "");
  const room = made("div", "", { class: "folded" }), inside = list(room);
  /** @type {Held<boolean>} */
  const held = new Held();
  element.append(summary, room);
  summary.addEventListener("click", (event) => {
    event.preventDefault();
    held.set(!element.open);
    element.open = !element.open;
    send({ t: "fold", id, open: element.open });
  });
  return { element, update: ({ s, open, nodes, tip }) => {
    write(summary, s ?? "");
    explain(summary, tip);
    const isOpen = held.shown(Boolean(open));
    if (element.open !== isOpen) element.open = isOpen;
    inside.update(isOpen ? nodes ?? [] : []);
  }, dispose: () => inside.dispose() };
};

/** @type {(node: Node, context: Context) => Widget} */
const table = (_, { list }) => {
  const element = made("div", "", { class: "table" });
  /** @type {ReturnType<Context["list"]>[]} */
  let cells = [];
  return { element, update: ({ widths = [], rows = [] }) => {
    const columns = widths.map((width) => width ? `${width}em` : "minmax(0,1fr)").join(" ");
    if (element.style.gridTemplateColumns !== columns) element.style.gridTemplateColumns = columns;
    const wanted = rows.flatMap((row) => widths.map((_width, k) => row[k] ?? []));
    for (const cell of cells.splice(wanted.length)) {
      cell.dispose();
      cell.room.remove();
    }
    while (cells.length < wanted.length) {
      const room = made("div", "", { class: "cell" });
      element.append(room);
      cells.push(list(room));
    }
    wanted.forEach((nodes, k) => cells[k].update(nodes));
  }, dispose: () => { for (const cell of cells) cell.dispose(); cells = []; } };
};

/** @type {(node: Node, context: Context) => Widget} */
const button = ({ id }, { send }) => {
  const element = made("button", "", { type: "button" });
  element.addEventListener("click", () => send({ t: "widget", id, value: true }));
  return { element, update: (node) => {
    write(element, node.s ?? "");
    common(element, node);
  } };
};

/** @type {(node: Node, context: Context) => Widget} */
const select = ({ id }, { send }) => {
  const element = made("button", "", { type: "button", class: "select" });
  element.addEventListener("click", () => send({ t: "widget", id, value: true }));
  return { element, update: (node) => {
    write(element, node.s ?? "");
    mark(element, "aria-pressed", String(Boolean(node.lit)));
    common(element, node);
  } };
};

/** @type {(node: Node, context: Context) => Widget} */
const search = ({ id }, { send }) => {
  const element = made("input", "", { type: "search", autocomplete: "off", spellcheck: "false" });
  /** @type {Held<string>} */
  const held = new Held();
  element.addEventListener("input", () => {
    held.set(element.value);
    send({ t: "widget", id, value: element.value });
  });
  return { element, update: (node) => {
    held.isHeld = document.activeElement === element;
    const text = held.shown(node.text ?? "");
    if (element.value !== text) element.value = text;
    mark(element, "placeholder", node.hint ?? "");
    common(element, node);
  } };
};

/** @type {(node: Node, context: Context) => Widget} */
const check = ({ id }, { send }) => {
  const box = made("input", "", { type: "checkbox" }), { element, describe } = labelled(box, "check");
  /** @type {Held<boolean>} */
  const held = new Held();
  box.addEventListener("change", () => {
    held.set(box.checked);
    send({ t: "widget", id, value: box.checked });
  });
  return { element, update: (node) => {
    const isOn = held.shown(Boolean(node.on));
    if (box.checked !== isOn) box.checked = isOn;
    describe(node);
    explain(element, node.tip);
  } };
};

/** @type {(node: Node, context: Context) => Widget} */
const choose = ({ id }, { send }) => {
  const box = made("select", ""), { element, describe } = labelled(box, "choose");
  /** @type {Held<number>} */
  const held = new Held();
  let listed = "";
  box.addEventListener("change", () => {
    held.set(box.selectedIndex);
    send({ t: "widget", id, value: box.selectedIndex });
  });
  return { element, sized: box, update: (node) => {
    const names = node.names ?? [], list = names.join("\0");
    if (list !== listed) box.replaceChildren(...names.map((name) => made("option", name)));
    const index = held.shown(node.index ?? -1);
    if (box.selectedIndex !== index || list !== listed) box.selectedIndex = index;
    listed = list;
    describe(node);
  } };
};

/** @type {(node: Node, context: Context) => Widget} */
const slide = ({ id }, { send }) => {
  const box = made("input", "", { type: "range", step: "any" }), output = made("output", "");
  const track = made("span", "", { class: "track" }), over = made("span", "", { class: "ticks" });
  const rail = made("span", "", { class: "rail" }); // the slider without its text
  const { element, describe } = labelled(box, "slide");
  element.prepend(track);
  rail.append(box, over);
  track.append(rail, output);
  /** @type {Held<number>} */
  const held = new Held();
  /** @param {number} value */
  const set = (value) => {
    held.set(value);
    send({ t: "widget", id, value });
  };
  const ticks = new Ticks(over, set);
  box.addEventListener("pointerdown", () => {
    held.isHeld = true;
    output.style.width = `${output.offsetWidth}px`; // A longer text would move the knob.
    held.set(box.valueAsNumber);
  });
  for (const end of ["pointerup", "pointercancel", "blur"]) {
    box.addEventListener(end, () => {
      held.isHeld = false;
      output.style.width = "";
    });
  }
  box.addEventListener("input", () => {
    const { valueAsNumber: value } = box, [low, high] = [Number(box.min), Number(box.max)];
    const round = rounded(value, DRAGGED * stepOf(low, high));
    set(value === low || value === high ? value : Math.min(Math.max(round, low), high)); // The ends may have more digits.
  });
  box.addEventListener("keydown", (event) => {
    const places = PLACES[event.key], { ctrlKey, altKey, metaKey } = event;
    if (!places || ctrlKey || altKey || metaKey) return;
    event.preventDefault();
    const step = stepOf(Number(box.min), Number(box.max));
    box.value = String(rounded(box.valueAsNumber + places * step, step)); // The browser limits the value to the range.
    set(box.valueAsNumber);
  });
  return { element, sized: track, update: (node) => {
    const { low = 0, high = 1, text = "" } = node, value = held.shown(node.value ?? low);
    mark(box, "min", String(low));
    mark(box, "max", String(high));
    if (box.valueAsNumber !== value) box.value = String(value);
    box.style.setProperty("--done", `${100 * Math.min(Math.max((value - low) / (high - low || 1), 0), 1)}%`);
    write(output, text);
    ticks.update((node.ticks ?? []).map(([begin, kind, words, end = begin, label = ""]) => ({ begin, end, text: words, kind, label })), low, high);
    ticks.showAt(value);
    const number = text || String(Number(value.toPrecision(4)));
    mark(box, "aria-valuetext", [number, ticks.text].filter(Boolean).join(", "));
    describe(node);
  } };
};

/** @type {(node: Node, context: Context) => Widget} */
const number = ({ id }, { send }) => {
  const box = made("input", "", { type: "text", inputmode: "decimal", autocomplete: "off", spellcheck: "false" });
  const { element, describe } = labelled(box, "number");
  let [text, value, isTyped] = ["", 0, false];
  box.addEventListener("focus", () => {
    box.value = plain(text, value);
    box.select();
  });
  box.addEventListener("input", () => { isTyped = true; });
  box.addEventListener("blur", () => {
    isTyped = false;
    box.value = text;
  });
  box.addEventListener("keydown", (event) => {
    if (event.key === "Escape") box.blur();
    if (event.key !== "Enter") return;
    const typed = Number(box.value.trim().replace(",", "."));
    isTyped = false;
    if (box.value.trim() && Number.isFinite(typed)) send({ t: "widget", id, value: typed });
    else box.value = plain(text, value);
    box.select();
  });
  return { element, sized: box, update: (node) => {
    [text, value] = [node.text ?? "", node.value ?? 0];
    const isIn = document.activeElement === box;
    if (!isIn && box.value !== text) box.value = text;
    if (isIn && !isTyped && box.selectionStart === 0 && box.value !== plain(text, value)) {
      box.value = plain(text, value);
      box.select();
    }
    describe(node);
  } };
};

/** Returns the number in a text, with its decimals. @param {string} text @param {number} value */
function plain(text, value) {
  return /-?\d+(\.\d+)?(e[-+]?\d+)?/i.exec(text)?.[0] ?? String(value);
}

/** @type {(node: Node, context: Context) => Widget} */
const lines = () => {
  const element = made("textarea", "", { readonly: "", spellcheck: "false" });
  return { element, update: (node) => {
    if (element.value !== node.text) element.value = node.text ?? "";
    mark(element, "rows", String(node.count ?? 2));
    common(element, { ...node, s: "", aria: node.aria ?? "text to copy" });
  } };
};

/** @type {(node: Node, context: Context) => Widget} */
const plot = ({ id }, { send }) => {
  const graph = new Graph((value) => send({ t: "widget", id, value }));
  return { element: graph.element, graph, update: (node) => graph.update(/** @type {any} */ (node)),
    dispose: () => graph.dispose() };
};

/** Functions that create widgets, by kind. @type {Record<string, (node: Node, context: Context) => Widget>} */
export const WIDGETS = {
  text: words("p", "text"), label: words("span", "words"), title: words("h3", "title"),
  header: folding("header"), tree: folding("tree"),
  table, button, select, search, check, choose, slide, number, lines, plot,
};
