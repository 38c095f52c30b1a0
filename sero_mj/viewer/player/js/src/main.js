/** The player of a run: puts picture, cards, time line and plot together. */

import { Cards } from "./cards.js";
import { Clock, SPEEDS } from "./clock.js";
import { decode, inflate, textOf, valueOf } from "./data.js";
import { Labels } from "./labels.js";
import { Plot, wordFor } from "./plot.js";
import { Stage } from "./stage.js";

const KEYS = [
  ["drag", "turn; with the right button move"],
  ["wheel", "nearer and farther"],
  ["click", "name and numbers of an arrow, link or card"],
  ["space", "play or pause"],
  [". ,", "a frame on, back"],
  ["→ ←", "1 s on, back"],
  ["+ −", "faster, slower"],
  ["backspace, end", "to the start, to the end"],
  ["e w", "next mark, the one before"],
  ["] [", "next joint, the one before"],
  ["a b d l", "arrows, billboards, doubles, legend"],
  ["p", "plot"],
  ["0 … 9", "initial view, cameras"],
  ["h", "this help"],
];
const VECTOR = 5; // kind of smart arrows, `Kind` in Python

/** @template {Element} [T=HTMLElement] @param {string} id */
const byId = (id) => /** @type {T} */ (/** @type {unknown} */ (document.getElementById(id)));

/** @param {string} tag @param {string} text @param {Record<string, string>} [attributes] */
function made(tag, text, attributes = {}) {
  const element = document.createElement(tag);
  element.textContent = text;
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

/** The whole page. */
class Player {
  /** @param {import("./data.js").Run} run */
  constructor(run) {
    this.run = run;
    this.clock = new Clock(run.frames, run.fps);
    this.stage = new Stage(run, byId("picture"));
    this.cards = new Cards(run, byId("cards"), byId("leaders"), (joint) => this.select({ joint }));
    this.labels = new Labels(run, byId("stage"));
    this.plot = new Plot(run, byId("plot"), (seconds) => this.seek(seconds));
    /** @type {Record<string, boolean>} */
    this.switches = { ...run.switches, shadows: true };
    this.chosen = -1;
    /** @type {{joint?: number, body?: string, kind?: number, item?: number} | null} */
    this.selected = null;
    this.isDirty = true;
    this.calls = 0;
    this.before = 0;
    this.#fill();
    this.#listen();
    const wanted = new URLSearchParams(location.hash.slice(1));
    this.setLook(matchMedia("(prefers-color-scheme: dark)").matches ? "dark"
      : matchMedia("(prefers-color-scheme: light)").matches ? "light" : run.look);
    this.resize();
    this.choose(this.#mostLoaded());
    if (wanted.has("t")) this.seek(Number(wanted.get("t")) || 0);
    else this.clock.isPlaying = run.frames > 1;
    this.draw();
    requestAnimationFrame((time) => this.#tick(time));
  }

  #fill() {
    const { run, clock } = this;
    document.title = run.title;
    byId("title").textContent = run.title.replaceAll("_", " ");
    const own = run.joints.filter((joint) => joint.double < 0).length;
    const about = [...(own ? [`${own} joints`] : []), run.frames > 1 ? `${clock.end.toFixed(1)} s` : "a pose"];
    const failed = run.marks.filter((mark) => mark.kind === "failed");
    const held = run.marks.filter((mark) => mark.kind === "held");
    const judged = failed.length + held.length;
    if (judged) about.push(failed.length ? `${failed.length} of ${judged} expectations failed` : `all ${judged} expectations held`);
    if (run.silent.length) about.push(`no data from ${run.silent.join(", ")}`);
    byId("about").textContent = about.join(" · ");
    byId("about").classList.toggle("failed", failed.length > 0);
    const names = { arrows: "arrows", numbers: "numbers", doubles: "doubles", shadows: "shadows" };
    for (const [key, name] of Object.entries(names)) {
      if (!this.#has(key)) continue;
      const button = made("button", name, { type: "button", "aria-pressed": String(this.switches[key]), "data-switch": key });
      button.addEventListener("click", () => this.toggle(key));
      byId("switches").append(button);
    }
    const cameras = byId("camera");
    cameras.append(made("option", "view", { value: "-1" }));
    run.cameras.forEach((camera, k) => cameras.append(made("option", camera.name || `camera ${k + 1}`, { value: String(k) })));
    cameras.hidden = !run.cameras.length;
    const joints = byId("joint");
    joints.hidden = !own;
    run.joints.forEach((joint, j) => joints.append(made("option", joint.name, { value: String(j) })));
    for (const speed of SPEEDS) byId("speed").append(made("option", `${speed}×`, { value: String(speed) }));
    /** @type {HTMLSelectElement} */ (byId("speed")).value = "1";
    byId("time").setAttribute("max", String(run.frames - 1));
    let free = -Infinity; // where the last text on the time line ends, as a share of it
    for (const mark of [...run.marks].sort((a, b) => a.begin - b.begin)) {
      const begin = mark.begin / Math.max(clock.end, 1e-9), hasText = mark.end > mark.begin && begin > free;
      if (hasText) free = begin + 0.012 * Math.min(mark.text.length, 12);
      byId("marks").append(this.#mark(mark, hasText));
    }
    document.body.classList.toggle("still", run.frames < 2);
    for (const [keys, words] of KEYS) byId("keys").append(made("dt", keys), made("dd", words));
  }

  /** Whether there is anything that a switch would hide. @param {string} key */
  #has(key) {
    const { run } = this, hasJoints = run.joints.length > 0;
    if (key === "doubles") return run.bodies.some((body) => body.double >= 0);
    if (key === "arrows") return hasJoints || run.switches.arrows;
    return key !== "numbers" || hasJoints || run.cards.length > 0;
  }

  /** @param {import("./data.js").Mark} mark @param {boolean} hasText */
  #mark(mark, hasText) {
    const end = Math.max(this.clock.end, 1e-9), { begin, text, kind } = mark;
    const button = made("button", "", { type: "button", class: `mark ${kind}`, title: `${begin.toFixed(2)} s: ${text}`,
      "aria-label": `${kind}: ${text}, at ${begin.toFixed(2)} s` });
    if (hasText) button.append(made("span", text));
    button.style.left = `${100 * Math.min(Math.max(begin / end, 0), 1)}%`;
    if (mark.end > begin) button.style.width = `${100 * (Math.min(mark.end, end) - begin) / end}%`;
    button.addEventListener("click", () => this.seek(begin));
    return button;
  }

  #listen() {
    const { clock, stage } = this, on = (/** @type {string} */ id, /** @type {() => void} */ act) =>
      byId(id).addEventListener("click", () => { act(); this.isDirty = true; });
    on("play", () => clock.toggle());
    on("back", () => clock.step(-1));
    on("on", () => clock.step(1));
    on("loop", () => { clock.isLooping = !clock.isLooping; });
    on("look", () => this.setLook(document.documentElement.dataset.look === "dark" ? "light" : "dark"));
    on("help", () => this.toggleHelp());
    const time = /** @type {HTMLInputElement} */ (byId("time"));
    time.addEventListener("input", () => {
      clock.isPlaying = false;
      clock.seek(Number(time.value));
      this.isDirty = true;
    });
    byId("camera").addEventListener("change", (event) => this.chooseCamera(Number(valueIn(event))));
    byId("joint").addEventListener("change", (event) => this.choose(Number(valueIn(event))));
    byId("speed").addEventListener("change", (event) => { clock.speed = Number(valueIn(event)); });
    stage.orbit.addEventListener("change", () => { this.isDirty = true; });
    stage.orbit.addEventListener("start", () => {
      stage.free();
      this.#show();
    });
    this.#listenToClicks();
    addEventListener("keydown", (event) => this.#press(event));
    new ResizeObserver(() => this.resize()).observe(byId("stage"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", (event) => this.setLook(event.matches ? "dark" : "light"));
    const canvas = stage.canvas;
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.tell("The browser has taken the graphics away; the picture comes back when it gives them back.");
    });
    canvas.addEventListener("webglcontextrestored", () => {
      this.tell("");
      this.isDirty = true;
    });
  }

  #listenToClicks() {
    const { canvas } = this.stage;
    let down = { x: 0, y: 0 };
    canvas.addEventListener("pointerdown", (event) => { down = { x: event.clientX, y: event.clientY }; });
    canvas.addEventListener("pointerup", (event) => {
      if (Math.hypot(event.clientX - down.x, event.clientY - down.y) > 5 || event.button) return;
      const { left, top } = canvas.getBoundingClientRect();
      this.select(this.stage.pick(event.clientX - left, event.clientY - top));
    });
  }

  /** @param {KeyboardEvent} event */
  #press(event) {
    const { clock } = this, target = /** @type {HTMLElement} */ (event.target);
    const isControl = target.tagName === "SELECT" || target.tagName === "INPUT" || target.tagName === "BUTTON";
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (isControl && ["ArrowLeft", "ArrowRight", "Home", "End", " ", "Enter", "Backspace"].includes(event.key)) return;
    /** @type {Record<string, () => void>} */
    const acts = {
      " ": () => clock.toggle(),
      ".": () => clock.step(1), ",": () => clock.step(-1),
      ArrowRight: () => clock.seek(clock.at + clock.fps), ArrowLeft: () => clock.seek(clock.at - clock.fps),
      "+": () => clock.changeSpeed(1), "-": () => clock.changeSpeed(-1),
      Backspace: () => clock.seek(0), End: () => clock.seek(Infinity),
      e: () => this.goToMark(1), w: () => this.goToMark(-1),
      "]": () => this.nextJoint(1), "[": () => this.nextJoint(-1),
      a: () => this.toggle("arrows"), b: () => this.toggle("numbers"), d: () => this.toggle("doubles"),
      l: () => this.toggle("legend"), p: () => document.body.classList.toggle("noplot"),
      h: () => this.toggleHelp(),
    };
    const act = /^\d$/.test(event.key) ? () => this.chooseCamera(Number(event.key) - 1) : acts[event.key];
    if (!act) return;
    event.preventDefault();
    act();
    this.isDirty = true;
  }

  /** @param {string} text shown over the picture; empty for nothing */
  tell(text) {
    byId("problem").textContent = text;
    byId("problem").hidden = !text;
  }

  toggleHelp() {
    const dialog = /** @type {HTMLDialogElement} */ (/** @type {unknown} */ (byId("helptext")));
    if (dialog.open) dialog.close();
    else dialog.showModal();
  }

  /** @param {string} key */
  toggle(key) {
    this.switches[key] = !this.switches[key];
    this.isDirty = true;
  }

  /** @param {number} number -1 for the scene's view */
  chooseCamera(number) {
    this.stage.chooseCamera(number);
    this.isDirty = true;
  }

  /** @param {number} seconds since the start */
  seek(seconds) {
    this.clock.isPlaying = false;
    this.clock.seek(seconds * this.clock.fps);
    this.isDirty = true;
  }

  /** @param {number} places */
  goToMark(places) {
    const times = this.run.marks.map((mark) => mark.begin).sort((a, b) => a - b);
    const there = times.filter((time) => (time - this.clock.time) * places > 1e-3);
    if (there.length) this.seek(places > 0 ? there[0] : there[there.length - 1]);
  }

  /** @param {number} places */
  nextJoint(places) {
    const count = this.run.joints.length;
    if (count) this.select({ joint: (this.chosen + places + count) % count });
  }

  /** The joint whose torque comes nearest to its limit; else the first. */
  #mostLoaded() {
    const { joints, frames } = this.run;
    /** @type {[number, number]} */
    let [best, most] = [joints.length ? 0 : -1, 0];
    joints.forEach((joint, j) => {
      for (let frame = 0; frame < frames && joint.double < 0; frame++) {
        const share = valueOf(this.run, j, "torque_share", frame);
        if (share > most) [best, most] = [j, share];
      }
    });
    return best;
  }

  /** Plots a joint. @param {number} joint */
  choose(joint) {
    this.chosen = joint;
    this.cards.choose(joint);
    this.plot.show(joint);
    /** @type {HTMLSelectElement} */ (byId("joint")).value = String(joint);
    byId("legend").hidden = joint < 0 || !this.run.values.torques;
    if (joint >= 0) {
      byId("legend").dataset.measured = wordFor(this.run, joint, "torques");
      byId("legend").dataset.commanded = wordFor(this.run, joint, "commanded_torques");
    }
    this.isDirty = true;
  }

  /** Shows name and numbers of what was clicked on. @param {Player["selected"]} picked */
  select(picked) {
    this.selected = picked;
    this.cards.vector = picked?.kind === VECTOR ? picked.item ?? -1 : -1;
    if (picked && picked.joint !== undefined && picked.joint >= 0) this.choose(picked.joint);
    this.isDirty = true;
  }

  /** Writes name and numbers of what is selected. */
  #describe() {
    const { run, selected } = this, box = byId("details"), { frame } = this.clock;
    box.hidden = !selected;
    if (!selected) return;
    const joint = selected.joint !== undefined && selected.joint >= 0 ? run.joints[selected.joint] : null;
    /** @type {[string, string][]} */
    const rows = [];
    let name = selected.body || (joint ? joint.name : "");
    if (joint && selected.joint !== undefined) {
      if (selected.body && selected.body !== joint.name) rows.push(["joint", joint.name]);
      const angle = valueOf(run, selected.joint, "joint_angles", frame);
      if (Number.isFinite(angle)) rows.push(["angle", `${angle.toFixed(3)} ${joint.angleUnit}`]);
      for (const line of joint.details) {
        const value = valueOf(run, selected.joint, line.key, frame);
        if (Number.isFinite(value)) rows.push([WORDS[line.label] || line.label, textOf(line, value)]);
      }
    } else if (selected.kind === VECTOR && selected.item !== undefined) {
      const card = run.cards.find((each) => each.item === selected.item);
      name = run.vectors[selected.item];
      if (card) rows.push(["value", card.texts[card.at[frame]]]);
    }
    const list = document.createElement("dl");
    for (const [word, text] of rows) list.append(made("dt", word), made("dd", text));
    box.replaceChildren(made("h2", name || "decor"), list);
  }

  /** @param {"light" | "dark"} look */
  setLook(look) {
    document.documentElement.dataset.look = look;
    byId("look").textContent = look === "dark" ? "☀" : "☾";
    this.stage.setLook(look);
    this.plot.show(this.chosen);
    this.isDirty = true;
  }

  resize() {
    const { clientWidth, clientHeight } = byId("stage");
    this.stage.resize(clientWidth, clientHeight);
    this.cards.forgetSizes();
    this.plot.resize();
    this.isDirty = true;
  }

  /** What of the page says what is on. */
  #show() {
    const { clock, run, switches } = this;
    byId("play").textContent = clock.isPlaying ? "❚❚" : "▶";
    byId("play").setAttribute("aria-label", clock.isPlaying ? "Pause" : "Play");
    byId("loop").setAttribute("aria-pressed", String(clock.isLooping));
    for (const button of document.querySelectorAll("[data-switch]")) {
      button.setAttribute("aria-pressed", String(switches[/** @type {HTMLElement} */ (button).dataset.switch ?? ""]));
    }
    /** @type {HTMLSelectElement} */ (byId("camera")).value = String(this.stage.fixed);
    /** @type {HTMLSelectElement} */ (byId("speed")).value = String(clock.speed);
    const time = /** @type {HTMLInputElement} */ (byId("time")), seconds = (run.begin + clock.time).toFixed(2);
    time.value = String(clock.at);
    time.style.setProperty("--done", `${100 * clock.at / Math.max(run.frames - 1, 1)}%`);
    time.setAttribute("aria-valuetext", `${seconds} s`);
    byId("now").textContent = `${seconds} s`;
    const notes = run.notes.texts[run.notes.at[clock.frame]];
    if (byId("notes").textContent !== notes) byId("notes").textContent = notes;
    byId("notes").hidden = !switches.legend || !notes;
  }

  /** Draws the time that is shown. */
  draw() {
    const { stage, switches, clock, run } = this;
    const areSome = run.joints.some((joint) => joint.arrow.on);
    stage.place(clock.at, switches, (j) => switches.arrows && (run.joints[j].arrow.on || !areSome)
      && (run.joints[j].double < 0 || switches.doubles));
    this.calls = stage.draw();
    const top = byId("tools").offsetHeight + byId("tools").offsetTop + 10;
    this.cards.layOut(stage, clock.frame, switches.numbers, top);
    this.labels.layOut(stage, clock.frame);
    this.plot.setTime(clock.time);
    this.#show();
    this.#describe();
  }

  /** @param {number} time ms */
  #tick(time) {
    const passed = this.before ? time - this.before : 0, { clock } = this;
    this.before = time;
    if (clock.isPlaying && passed) {
      clock.advance(Math.min(passed, 250) / 1000);
      if (this.stage.notePace(passed)) this.switches.shadows = false;
      this.isDirty = true;
    }
    if (this.isDirty) {
      this.isDirty = false;
      this.draw();
    }
    requestAnimationFrame((next) => this.#tick(next));
  }
}

/** @type {Record<string, string>} */
const WORDS = { cmd: "commanded", msr: "measured", err: "difference", limit: "limit", share: "of the limit" };

/** @param {Event} event */
const valueIn = (event) => /** @type {HTMLSelectElement} */ (event.target).value;

async function main() {
  const data = byId("run"), text = data.textContent ?? "";
  data.textContent = "";
  const player = new Player(decode(await inflate(text)));
  Object.assign(globalThis, { player }); // for consoles and tests
  document.documentElement.dataset.ready = "1";
}

main().catch((error) => {
  const problem = byId("problem");
  problem.hidden = false;
  problem.append(` (${error.message})`);
  document.documentElement.dataset.ready = "0";
});
