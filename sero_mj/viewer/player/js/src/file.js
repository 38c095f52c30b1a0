/** The page of a run in a file: its picture, time line, plot, and what was clicked on. */

import { addStraight } from "./arrows.js";
import { Clock, SPEEDS } from "./clock.js";
import { fixed, textOf, valueOf } from "./data.js";
import { Geoms, geomsAt, VECTOR } from "./geoms.js";
import { JointCards } from "./joint_cards.js";
import { labelsAt } from "./labels.js";
import { lookToOpen, onOtherLook } from "./look.js";
import { boxesOf, byId, made, valueIn } from "./page.js";
import { Plot } from "./plot.js";
import { Ticks } from "./ticks.js";
import { View } from "./view.js";

const KEYS = [
  ["drag", "turn; with the right button, move"],
  ["wheel", "zoom"],
  ["click", "name and numbers of an arrow, link or card"],
  ["space", "play or pause"],
  [". ,", "one frame forward, back"],
  ["→ ←", "1 s forward, back"],
  ["+ −", "faster, slower"],
  ["backspace, end", "to the start, to the end"],
  ["e w", "next, previous mark"],
  ["] [", "next, previous joint"],
  ["a b d l", "arrows, billboards, doubles, legend"],
  ["q", "arrows show torque, or its error"],
  ["p", "plot"],
  ["0 … 9", "initial view, cameras"],
  ["h", "this help"],
];
const BESIDE = 8; // pixels between boxes at the foot of the picture
const NARROW = 280; // pixels, in which what happened is not told

/** The whole page. */
export class Player {
  /** @param {import("./data.js").Run} run */
  constructor(run) {
    this.run = run;
    this.clock = new Clock(run.frames, run.fps);
    this.quantity = 0; // of `run.arrows.quantities`
    this.plot = new Plot(run, byId("plot"), byId("legend"), (seconds) => this.seek(seconds));
    this.ticks = new Ticks(byId("marks"), (seconds) => this.seek(seconds));
    this.cards = new JointCards(run);
    this.geoms = new Geoms();
    /** @type {Record<string, boolean>} */
    this.switches = { ...run.switches, shadows: true };
    this.chosen = -1;
    /** @type {{joint?: number, body?: string, kind?: number, item?: number} | null} */
    this.selected = null;
    this.view = new View({
      frame: (passed) => this.#frame(passed),
      card: (key) => { if (key.startsWith("joint ")) this.select({ joint: Number(key.slice(6)) }); },
      turn: () => {},
      look: () => this.plot.show(this.chosen),
      resize: () => this.plot.resize(),
    });
    this.#fill();
    this.view.show(run);
    this.#listen();
    const wanted = new URLSearchParams(location.hash.slice(1));
    this.view.setLook(lookToOpen());
    this.choose(this.#mostLoaded());
    if (wanted.has("t")) this.seek(Number(wanted.get("t")) || 0);
    else this.clock.isPlaying = run.frames > 1;
    this.draw();
  }

  get stage() { return this.view.stage; }

  get calls() { return this.view.calls; }

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
    const names = { arrows: "arrows", numbers: "billboards", doubles: "doubles", shadows: "shadows" };
    for (const [key, name] of Object.entries(names)) {
      if (!this.#has(key)) continue;
      const button = made("button", name, { type: "button", "aria-pressed": String(this.switches[key]), "data-switch": key });
      button.addEventListener("click", () => this.toggle(key));
      byId("switches").append(button);
      if (key === "arrows" && run.arrows.quantities.length) {
        const other = made("button", "", { type: "button", id: "quantity", title: "what arrows show (q)" });
        other.addEventListener("click", () => this.nextQuantity());
        byId("switches").append(other);
      }
    }
    const joints = byId("joint");
    joints.hidden = !own;
    run.joints.forEach((joint, j) => joints.append(made("option", joint.name, { value: String(j) })));
    for (const speed of SPEEDS) byId("speed").append(made("option", `x ${speed}`, { value: String(speed) }));
    /** @type {HTMLSelectElement} */ (byId("speed")).value = "1";
    byId("time").setAttribute("max", String(run.frames - 1));
    this.ticks.update(ticksOf(run), 0, clock.end);
    document.body.classList.toggle("still", run.frames < 2);
    const keysHere = KEYS.filter(([key]) => key !== "q" || run.arrows.quantities.length);
    for (const [keys, words] of keysHere) byId("keys").append(made("dt", keys), made("dd", words));
  }

  /** Whether there is anything that a switch would hide. @param {string} key */
  #has(key) {
    const { run } = this, hasJoints = run.joints.length > 0;
    if (key === "doubles") return run.bodies.some((body) => body.double >= 0);
    if (key === "arrows") return hasJoints || run.switches.arrows;
    return key !== "numbers" || hasJoints || run.cards.length > 0;
  }

  #listen() {
    const { clock, view } = this, on = (/** @type {string} */ id, /** @type {() => void} */ act) =>
      byId(id).addEventListener("click", () => { act(); view.wake(); });
    on("play", () => clock.toggle());
    on("back", () => clock.step(-1));
    on("on", () => clock.step(1));
    on("loop", () => { clock.isLooping = !clock.isLooping; });
    on("help", () => this.toggleHelp());
    const time = /** @type {HTMLInputElement} */ (byId("time"));
    time.addEventListener("input", () => {
      clock.isPlaying = false;
      clock.seek(Number(time.value));
      this.view.wake();
    });
    byId("camera").addEventListener("change", (event) => this.chooseCamera(Number(valueIn(event))));
    byId("joint").addEventListener("change", (event) => this.choose(Number(valueIn(event))));
    byId("speed").addEventListener("change", (event) => { clock.speed = Number(valueIn(event)); });
    this.#listenToClicks();
    addEventListener("keydown", (event) => this.#press(event));
    onOtherLook(() => view.setLook(lookToOpen()));
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
      q: () => this.nextQuantity(), l: () => this.toggle("legend"), p: () => document.body.classList.toggle("noplot"),
      h: () => this.toggleHelp(),
    };
    const act = /^\d$/.test(event.key) ? () => this.chooseCamera(Number(event.key) - 1) : acts[event.key];
    if (!act) return;
    event.preventDefault();
    act();
    this.view.wake();
  }

  toggleHelp() {
    const dialog = /** @type {HTMLDialogElement} */ (/** @type {unknown} */ (byId("helptext")));
    if (dialog.open) dialog.close();
    else dialog.showModal();
  }

  /** @param {string} key */
  toggle(key) {
    this.switches[key] = !this.switches[key];
    this.view.wake();
  }

  /** Lets round arrows show what is next of what they can. */
  nextQuantity() {
    const { arrows, values } = this.run, { quantities } = arrows;
    if (!quantities.length) return;
    this.quantity = (this.quantity + 1) % quantities.length;
    const { key } = quantities[this.quantity];
    arrows.values = values[key];
    this.cards.quantity = key;
    this.view.wake();
  }

  /** @param {number} number -1 for the scene's view */
  chooseCamera(number) {
    this.stage.chooseCamera(number);
    this.view.wake();
  }

  /** @param {number} seconds since the start */
  seek(seconds) {
    this.clock.isPlaying = false;
    this.clock.seek(seconds * this.clock.fps);
    this.view.wake();
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
    this.cards.chosen = joint;
    this.plot.show(joint);
    /** @type {HTMLSelectElement} */ (byId("joint")).value = String(joint);
    this.view.wake();
  }

  /** Shows name and numbers of what was clicked on. @param {Player["selected"]} picked */
  select(picked) {
    this.selected = picked;
    this.cards.vector = picked?.kind === VECTOR ? picked.item ?? -1 : -1;
    if (picked && picked.joint !== undefined && picked.joint >= 0) this.choose(picked.joint);
    this.view.wake();
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
      if (Number.isFinite(angle)) rows.push(["angle", `${fixed(angle, 3)} ${joint.angleUnit}`]);
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

  get #seconds() { return (this.run.begin + this.clock.time).toFixed(2); }

  /**
   * Tells what is near the time, beside legend and details or above them.
   * @returns {number} pixels that this needs
   */
  #tell() {
    const { ticks, clock } = this, stage = byId("stage").getBoundingClientRect();
    const room = { left: stage.left + BESIDE, right: stage.right - BESIDE, up: 0 };
    const whole = { ...room };
    for (const { left, right, top } of boxesOf(["notes", "details"])) {
      whole.up = Math.max(whole.up, stage.bottom - top);
      if (left + right < stage.left + stage.right) room.left = Math.max(room.left, right + BESIDE);
      else room.right = Math.min(room.right, left - BESIDE);
    }
    const found = room.right - room.left < NARROW ? whole : room;
    ticks.tell(clock.time, found);
    const words = [`${this.#seconds} s`, ticks.told].filter(Boolean).join(", ");
    byId("time").setAttribute("aria-valuetext", words);
    return ticks.tallest && found.up + ticks.tallest + BESIDE;
  }

  /** What of the page says what is on. */
  #show() {
    const { clock, run, switches } = this;
    byId("play").textContent = clock.isPlaying ? "pause" : "play";
    byId("loop").setAttribute("aria-pressed", String(clock.isLooping));
    for (const button of document.querySelectorAll("[data-switch]")) {
      button.setAttribute("aria-pressed", String(switches[/** @type {HTMLElement} */ (button).dataset.switch ?? ""]));
    }
    /** @type {HTMLSelectElement} */ (byId("speed")).value = String(clock.speed);
    const time = /** @type {HTMLInputElement} */ (byId("time"));
    time.value = String(clock.at);
    time.style.setProperty("--done", `${100 * clock.at / Math.max(run.frames - 1, 1)}%`);
    byId("now").textContent = `${this.#seconds} s / ${(run.begin + clock.end).toFixed(2)} s`;
    const { quantities } = run.arrows, noted = run.notes.texts[run.notes.at[clock.frame]];
    const meant = switches.arrows ? run.legend.texts[run.legend.at[clock.frame]] : "";
    const { line } = quantities[this.quantity] ?? { line: "" };
    const legend = this.quantity ? meant.replace(/^round arrows: .*$/m, line) : meant;
    const notes = [noted, legend].filter(Boolean).join("\n\n");
    if (quantities.length) byId("quantity").textContent = quantities[this.quantity].name;
    if (byId("notes").textContent !== notes) byId("notes").textContent = notes;
    byId("notes").hidden = !switches.legend || !notes;
  }

  /** Draws the time that is shown. */
  draw() {
    const { view, switches, clock, run, geoms } = this, { frame } = clock;
    const areSome = run.joints.some((joint) => joint.arrow.on);
    const hasArrow = (/** @type {number} */ j) => switches.arrows
      && (run.joints[j].arrow.on || !areSome) && (run.joints[j].double < 0 || switches.doubles);
    this.stage.hasShadows = switches.shadows;
    this.#show();
    this.#describe();
    view.draw({
      foot: this.#tell(), at: clock.at, hasDoubles: switches.doubles, hasArrow,
      labels: labelsAt(run, frame),
      geoms: (sites) => {
        geomsAt(run, frame, switches.arrows, geoms);
        addStraight(run, clock.at, sites, hasArrow, geoms);
        return geoms;
      },
      cards: () => switches.numbers ? this.cards.at(this.stage, frame) : [],
    });
    this.plot.setTime(clock.time);
  }

  /** @param {number} passed ms since the last picture */
  #frame(passed) {
    const { clock, stage, view } = this;
    if (clock.isPlaying && passed) {
      clock.advance(Math.min(passed, 250) / 1000);
      stage.notePace(passed);
      this.switches.shadows &&= stage.hasShadows;
    }
    if (clock.isPlaying) view.wake();
    this.draw();
  }
}

/**
 * The marks of a run as ticks; those that take some time have their text on them where there is room.
 * @param {import("./data.js").Run} run
 * @returns {import("./ticks.js").Tick[]}
 */
function ticksOf(run) {
  return [...run.marks].sort((a, b) => a.begin - b.begin).map((mark) => {
    const outcome = mark.kind === "failed" || mark.kind === "held" ? `${mark.kind}: ` : "";
    const text = `${(run.begin + mark.begin).toFixed(2)} s: ${outcome}${mark.text}`;
    return { ...mark, text, label: mark.end > mark.begin ? mark.text : "" };
  });
}

/** @type {Record<string, string>} */
const WORDS = { cmd: "commanded", msr: "measured", err: "difference", limit: "limit", share: "of the limit" };
