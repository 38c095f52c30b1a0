/** The user interface around the image of a page: panels, plots and messages. */

import { byId, made, mark, write } from "./page.js";
import { Tree } from "./panels.js";

/** @typedef {import("./widgets.js").Node} Node */
/** @typedef {[text: string, mood: string]} Piece */
/** @typedef {(message: object) => void} Send */

/** An element with a tree of widgets, which is visible while the tree exists. */
class Room {
  /** @param {HTMLElement} element @param {string} name of the tree @param {Send} send */
  constructor(element, name, send) {
    this.element = element;
    this.tree = new Tree(element, name, send);
  }

  /** @param {Node[] | null} nodes */
  show(nodes) {
    if (this.element.hidden !== !nodes) this.element.hidden = !nodes;
    this.tree.update(nodes ?? []);
  }
}

/** A dialog that the server opens and closes. */
class Dialog {
  /**
   * @param {string} id of the dialog @param {string} room id of the element with the tree
   * @param {string} name of the tree @param {Send} send @param {string} key that closes the dialog
   */
  constructor(id, room, name, send, key) {
    this.dialog = byId(id);
    this.tree = new Tree(byId(room), name, send);
    this.close = () => send({ t: "key", key, repeat: false });
    this.element.addEventListener("cancel", (event) => {
      event.preventDefault();
      this.close();
    });
  }

  get element() { return /** @type {HTMLDialogElement} */ (/** @type {unknown} */ (this.dialog)); }

  /** @param {Node[] | null} nodes */
  show(nodes) {
    this.tree.update(nodes ?? []);
    if (nodes && !this.element.open) this.element.showModal();
    if (!nodes && this.element.open) this.element.close();
  }
}

/** The areas beside the image. Each area has a title and a close button. */
class Areas {
  /** @param {HTMLElement} room @param {Send} send */
  constructor(room, send) {
    this.room = room;
    this.send = send;
    /** @type {Map<string, {element: HTMLElement, title: HTMLElement, tree: Tree}>} */
    this.areas = new Map();
  }

  /** @param {{title: string, name: string, nodes: Node[]}[]} areas */
  show(areas) {
    const names = new Set(areas.map(({ name }) => name));
    for (const [name, { element, tree }] of this.areas) {
      if (names.has(name)) continue;
      tree.dispose();
      element.remove();
      this.areas.delete(name);
    }
    this.room.hidden = !areas.length;
    for (const { title, name, nodes } of areas) {
      const area = this.areas.get(name) ?? this.#make(name);
      write(area.title, title);
      mark(area.element, "aria-label", title);
      area.tree.update(nodes);
    }
  }

  /** @param {string} name */
  #make(name) {
    const element = made("section", "", { class: "area" }), title = made("h2", "");
    const close = made("button", "✕", { type: "button", "aria-label": "Close" });
    const room = made("div", "", { class: "nodes" });
    close.addEventListener("click", () => this.send({ t: "close", area: name }));
    element.append(title, close, room);
    this.room.append(element);
    const area = { element, title, tree: new Tree(room, `area:${name}`, this.send) };
    this.areas.set(name, area);
    return area;
  }
}

/** The whole user interface around the image. */
export class Surround {
  /** @param {Send} send */
  constructor(send) {
    this.panel = new Room(byId("panel"), "panel", send);
    this.timeLine = new Room(byId("timeline"), "timeLine", send);
    this.help = new Dialog("helptext", "keys", "help", send, "h");
    byId("close").addEventListener("click", this.help.close);
    /** The dialog about programs that a file requests to run. */
    this.request = new Dialog("request", "actions", "request", send, "escape");
    this.areas = new Areas(byId("areas"), send);
  }

  /**
   * Shows a section.
   * @param {string} name @param {any} value @returns {boolean} whether the section belongs to the user interface
   */
  take(name, value) {
    switch (name) {
      case "panel":
        this.panel.show(value);
        mark(byId("open"), "aria-expanded", String(Boolean(value)));
        return true;
      case "timeLine": this.timeLine.show(value); return true;
      case "help": this.help.show(value); return true;
      case "areas": this.areas.show(value ?? []); return true;
      case "about": return this.#about(value);
      case "status": return this.#status(value ?? []);
      case "details": return this.#details(value);
      case "notes": return this.#notes(value ?? []);
      case "message": return showPiece(byId("message"), value);
      case "ongoing": return showPiece(byId("ongoing"), value);
      case "hover": return this.#hover(value);
      default: return false;
    }
  }

  /** @param {{title?: string} | null} about */
  #about(about) {
    const title = about?.title ?? "";
    document.title = title ? `${title} - sero-mj` : "sero-mj";
    write(byId("title"), title.replaceAll("_", " "));
    return true;
  }

  /** @param {Piece[]} pieces */
  #status(pieces) {
    const room = byId("about");
    while (room.childElementCount > pieces.length) room.lastElementChild?.remove();
    while (room.childElementCount < pieces.length) room.append(made("span", ""));
    pieces.forEach(([text, mood], k) => {
      write(room.children[k], text);
      room.children[k].className = mood;
    });
    return true;
  }

  /** @param {string[][]} blocks */
  #notes(blocks) {
    byId("notes").hidden = !blocks.length;
    write(byId("notes"), blocks.map((block) => block.join("\n")).join("\n\n"));
    return true;
  }

  /** Shows the clicked item. @param {{name: string, rows: [string, string][]} | null} details */
  #details(details) {
    const box = byId("details");
    box.hidden = !details;
    if (!details) return true;
    const list = document.createElement("dl");
    for (const [word, text] of details.rows) list.append(made("dt", word), made("dd", text));
    box.replaceChildren(made("h2", details.name), list);
    return true;
  }

  /** @param {{text: string, x: number, y: number} | null} hover */
  #hover(hover) {
    const box = byId("hover");
    box.hidden = !hover;
    if (!hover) return true;
    write(box, hover.text);
    box.style.transform = `translate(${hover.x + 14}px,${hover.y + 14}px)`;
    return true;
  }
}

/** @param {HTMLElement} box @param {Piece | null} piece */
function showPiece(box, piece) {
  box.hidden = !piece;
  write(box, piece?.[0] ?? "");
  box.dataset.mood = piece?.[1] ?? "";
  return true;
}
