/** The transport of a recorded run, which sends the same sections to the player as the server of a live page. */

import { addArrows } from "./arrows.js";
import { Clock, SPEEDS } from "./clock.js";
import { fixed, textOf, valueOf } from "./data.js";
import { BILLBOARD, Geoms, VECTOR, geomsAt } from "./geoms.js";
import { evidencePlots } from "./evidence_plot.js";
import { JointBillboards } from "./joint_billboards.js";
import { labelsAt } from "./labels.js";
import { torquePlot } from "./torque_plot.js";

/** @typedef {import("./widgets.js").Node} Node */
/** @typedef {{joint?: number, body?: string, kind?: number, item?: number}} Picked */

const KEYS = [
  ["drag", "rotate the view, pan with the right button"],
  ["wheel", "zoom"],
  ["click", "show name and values of an arrow, link or billboard"],
  ["space", "play or pause"],
  [". ,", "one frame forward, back"],
  ["→ ←", "1 s forward, back"],
  ["+ −", "faster, slower"],
  ["backspace, end", "go to the start, go to the end"],
  ["e w", "next, previous mark"],
  ["] [", "next, previous joint"],
  ["a b d l", "arrows, billboards, doubles, legend on or off"],
  ["q", "next quantity of arrows"],
  ["p", "plot on or off"],
  ["t", "panel on or off"],
  ["0 … 9", "initial view (0), cameras (1 to 9)"],
  ["h", "this help"],
];
/** @type {Record<string, string>} */
const WORDS = { cmd: "commanded", msr: "measured", err: "difference", limit: "limit", share: "of the limit" };
const NAMES = { arrows: "arrows", numbers: "billboards", doubles: "doubles", legend: "legend", shadows: "shadows" };
const PANEL_INTERVAL = 66; // time between two updates of panels, ms
const NARROW = 700; // page width below which the timeline has two rows, pixels
const WIDE = 1100; // page width from which the panel is initially visible, pixels
const CLICK = 4; // maximum distance between press and release of a click, pixels

/** @typedef {import("./transport.js").Transport} Transport */

/** @implements {Transport} */
export class Recording {
  /** @param {import("./data.js").Run} run */
  constructor(run) {
    this.run = run;
    this.clock = new Clock(run.frames, run.fps);
    this.billboards = new JointBillboards(run);
    this.geoms = new Geoms();
    this.sites = null;
    this.quantity = 0; // index in `run.arrows.quantities`
    this.isPlotted = run.frames > 1 && run.joints.length > 0;
    this.showsHelp = false;
    this.width = 0; // width of the page, pixels
    this.hasPanel = false;
    /** @type {Record<string, boolean>} */
    this.switches = { ...run.switches };
    /** Sections that the user has opened or closed. @type {Record<string, boolean>} */
    this.folds = {};
    this.chosen = -1;
    /** @type {Picked | null} */
    this.selected = null;
    this.ticks = ticksOf(run);
    this.findings = run.marks.filter(({ plot }) => plot); // marks with evidence
    this.finding = -1; // index of the finding whose evidence is plotted
    /** @type {import("./graph.js").Content[]} */
    this.evidence = [];
    this.serial = 0; // number of camera motions by keys
    /** @type {{x: number, y: number} | null} */
    this.pressed = null;
    this.sent = -Infinity; // time at which panels were sent, ms
    this.hasChanged = true; // whether anything except the time has changed in the panels
    /** @type {import("./stage.js").Stage | null} */
    this.stage = null;
    /** @type {Transport["onmessage"]} */
    this.onmessage = () => {};
    this.onopen = this.onclose = this.onlocked = this.onother = this.onframe = () => {};
    this.hadControl = () => true;
    this.noteControl = () => {};
  }

  /** Starts the run. */
  open() {
    const { run } = this;
    this.onopen();
    this.#send({ you: { id: 1 }, control: { holder: 1, count: 1 }, about: { title: run.title }, status: statusOf(run) });
    this.choose(this.#mostLoaded());
    if (this.findings.length) this.chooseFinding(0);
    const wanted = new URLSearchParams(location.hash.slice(1)).get("t");
    if (wanted === null) this.clock.isPlaying = run.frames > 1;
    else this.seek(Number(wanted) || 0);
  }

  /** @param {Record<string, any>} json sections */
  #send(json) { this.onmessage({ json: new Map(Object.entries(json)), bytes: new Map() }); }

  /** Marks the image and the panels as changed. */
  #change() {
    this.hasChanged = true;
    this.onframe();
  }

  // ---- user input

  /** @param {string | ArrayBuffer} message */
  send(message) {
    const received = JSON.parse(String(message));
    switch (received.t) {
      case "key": this.#press(received.key); break;
      case "pointer": this.#point(received); return;
      case "card": if (received.kind === BILLBOARD) this.select({ joint: received.item }); break;
      case "widget": this.#act(received.id, received.value); break;
      case "fold": this.folds[received.id] = received.open; break;
      case "close": this.isPlotted = false; break;
      case "size": this.#fit(received.page); break;
      default: return;
    }
    this.#change();
  }

  /** @param {number} width of the page, pixels */
  #fit(width) {
    if ((this.width >= WIDE) !== (width >= WIDE)) this.hasPanel = width >= WIDE;
    this.width = width;
  }

  /** @param {string} key */
  #press(key) {
    const { clock } = this;
    /** @type {Record<string, () => void>} */
    const acts = {
      " ": () => clock.toggle(),
      ".": () => clock.step(1), ",": () => clock.step(-1),
      right: () => clock.seek(clock.at + clock.fps), left: () => clock.seek(clock.at - clock.fps),
      "+": () => clock.changeSpeed(1), "-": () => clock.changeSpeed(-1),
      backspace: () => clock.seek(0), end: () => clock.seek(Infinity),
      e: () => this.goToMark(1), w: () => this.goToMark(-1),
      "]": () => this.nextJoint(1), "[": () => this.nextJoint(-1),
      a: () => this.toggle("arrows"), b: () => this.toggle("numbers"), d: () => this.toggle("doubles"),
      l: () => this.toggle("legend"), q: () => this.nextQuantity(),
      p: () => { this.isPlotted = !this.isPlotted; },
      t: () => { this.hasPanel = !this.hasPanel; },
      h: () => { this.showsHelp = !this.showsHelp; },
    };
    if (/^\d$/.test(key)) this.#send({ camera: { ...this.run.eye, fixed: Number(key) - 1, by: null, serial: ++this.serial } });
    else acts[key]?.();
  }

  /** @param {{kind: string, x: number, y: number, button: number}} received */
  #point({ kind, x, y, button }) {
    const { pressed } = this;
    if (kind === "press") this.pressed = button ? null : { x, y };
    if (kind === "release" || kind === "leave") this.pressed = null;
    if (kind !== "release" || button || !pressed || Math.hypot(x - pressed.x, y - pressed.y) > CLICK) return;
    this.select(this.stage?.pick(x, y) ?? null);
  }

  /** @param {string} id of a widget @param {any} value */
  #act(id, value) {
    const { clock } = this;
    switch (id) {
      case "pause": clock.toggle(); break;
      case "start": clock.seek(0); break;
      case "back": clock.step(-1); break;
      case "on": clock.step(1); break;
      case "loop": clock.isLooping = value; break;
      case "speed": clock.speed = SPEEDS[value]; break;
      case "joint": this.#plotItem(value); break;
      case "quantity": this.nextQuantity(); break;
      case "time": case "plot": this.seek(value - this.run.begin); this.#findAt(value - this.run.begin); break;
      default: if (id in NAMES) this.toggle(id);
    }
  }

  /** @param {string} key */
  toggle(key) {
    if (key !== "shadows") this.switches[key] = !this.switches[key];
    else if (this.stage) this.stage.hasShadows = !this.stage.hasShadows;
    this.#change();
  }

  /** Makes round arrows show the next available quantity. */
  nextQuantity() {
    const { arrows, values } = this.run, { quantities } = arrows;
    if (!quantities.length) return;
    this.quantity = (this.quantity + 1) % quantities.length;
    const { key } = quantities[this.quantity];
    arrows.values = values[key];
    this.billboards.quantity = key;
    this.#change();
  }

  /** @param {number} seconds since the start */
  seek(seconds) {
    this.clock.isPlaying = false;
    this.clock.seek(seconds * this.clock.fps);
    this.#change();
  }

  /** @param {number} places */
  goToMark(places) {
    const times = this.run.marks.map((mark) => mark.begin).sort((a, b) => a - b);
    const there = times.filter((time) => (time - this.clock.time) * places > 1e-3);
    if (!there.length) return;
    const time = places > 0 ? there[0] : there[there.length - 1];
    this.seek(time);
    this.#findAt(time);
  }

  /** Plots the evidence of a mark that begins at a time. @param {number} time since the start, s */
  #findAt(time) {
    const found = this.findings.findIndex(({ begin }) => Math.abs(begin - time) < 1e-9);
    if (found >= 0) this.chooseFinding(found);
  }

  /** Plots an item of the list, which are joints and then findings. @param {number} item */
  #plotItem(item) {
    const { length } = this.run.joints;
    if (item < length) this.choose(item);
    else this.chooseFinding(item - length);
  }

  /** Plots the evidence of a finding, and marks its joint. @param {number} finding */
  chooseFinding(finding) {
    const { joints } = this.run, { plot } = this.findings[finding];
    const joint = joints.findIndex(({ name }) => name === plot?.joint);
    if (joint >= 0) this.choose(joint);
    this.finding = finding;
    this.evidence = plot ? evidencePlots(this.run, plot) : [];
    this.#change();
  }

  /** @param {number} places */
  nextJoint(places) {
    const count = this.run.joints.length;
    if (count) this.select({ joint: (this.chosen + places + count) % count });
  }

  /** Returns the joint with the largest torque relative to its limit, or the first joint. */
  #mostLoaded() {
    const { joints, frames } = this.run;
    let [best, highest] = [joints.length ? 0 : -1, 0];
    joints.forEach((joint, j) => {
      for (let frame = 0; frame < frames && joint.double < 0; frame++) {
        const share = valueOf(this.run, j, "torque_share", frame);
        if (share > highest) [best, highest] = [j, share];
      }
    });
    return best;
  }

  /** Plots a joint. @param {number} joint */
  choose(joint) {
    this.finding = -1;
    this.chosen = this.billboards.chosen = joint;
    if (joint >= 0) this.plot = torquePlot(this.run, joint);
    this.#change();
  }

  /** Shows the name and the values of the clicked item. @param {Picked | null} picked */
  select(picked) {
    this.selected = picked;
    this.billboards.vector = picked?.kind === VECTOR ? picked.item ?? -1 : -1;
    if (picked?.joint !== undefined && picked.joint >= 0) this.choose(picked.joint);
    this.#change();
  }

  // ---- output

  /** Advances the time, and sends panels that have changed. @param {number} passed ms since the last frame */
  advance(passed) {
    const { clock } = this, now = performance.now();
    if (clock.isPlaying) {
      clock.advance(Math.min(passed, 250) / 1000);
      this.hasChanged ||= !clock.isPlaying;
      this.onframe();
    }
    if (!this.hasChanged && now - this.sent < PANEL_INTERVAL) return;
    this.sent = now;
    this.hasChanged = false;
    this.#send({ panel: this.hasPanel ? this.#panel() : null, timeLine: this.run.frames > 1 ? this.#timeLine() : null,
      areas: this.isPlotted ? [this.#plotArea()] : [], help: this.showsHelp ? this.#help() : null,
      details: this.#details(), notes: this.switches.legend ? this.#notes() : [] });
  }

  /** Returns the current state to draw. @param {import("./stage.js").Stage} stage @returns {import("./view.js").Moment} */
  moment(stage) {
    const { run, clock, switches, geoms } = this, { frame } = clock;
    const areSome = run.joints.some((joint) => joint.arrow.on);
    const hasArrow = (/** @type {number} */ j) => switches.arrows
      && (run.joints[j].arrow.on || !areSome) && (run.joints[j].double < 0 || switches.doubles);
    return {
      at: clock.at, hasDoubles: switches.doubles, labels: labelsAt(run, frame),
      geoms: (sites) => {
        geomsAt(run, frame, switches.arrows, geoms);
        addArrows(run, clock.at, sites, hasArrow, geoms);
        return geoms;
      },
      billboards: () => switches.numbers ? this.billboards.at(stage, frame) : [],
    };
  }

  /** Returns the text in the corner, which consists of notes and legend. */
  #notes() {
    const { run, switches, clock: { frame } } = this, line = run.arrows.quantities[this.quantity]?.line ?? "";
    const note = run.notes.texts[run.notes.at[frame]], lines = run.legend.texts[run.legend.at[frame]];
    const legend = switches.arrows ? lines.map((each) => each ?? line) : [];
    return [note ? [note] : [], legend].filter((block) => block.length);
  }

  /** Returns whether a switch has an effect. @param {string} key */
  #has(key) {
    const { run } = this, hasJoints = run.joints.length > 0;
    if (key === "doubles") return run.bodies.some((body) => body.double >= 0);
    if (key === "arrows") return hasJoints || run.switches.arrows;
    if (key === "legend") return [...run.notes.texts, ...run.legend.texts].some(({ length }) => length);
    return key !== "numbers" || hasJoints || run.arrowTexts.length > 0;
  }

  /** @returns {Node[]} */
  #panel() {
    const { switches, stage, run: { arrows: { quantities } } } = this, open = this.folds.Shown ?? true;
    const nodes = Object.entries(NAMES).filter(([key]) => this.#has(key)).map(([id, s]) =>
      ({ k: "check", id, s, on: id === "shadows" ? stage?.hasShadows : switches[id] }));
    const names = quantities.map((/** @type {{name: string}} */ { name }) => name);
    const shown = [{ k: "choose", id: "quantity", s: "", aria: "quantity of arrows", index: this.quantity, names, width: 9 },
      { k: "label", s: "quantity of arrows", same: true }];
    return [{ k: "header", id: "Shown", s: "Display", open, nodes: quantities.length ? [...shown, ...nodes] : nodes }];
  }

  /** @returns {Node[]} */
  #timeLine() {
    const { clock, run: { begin }, width } = this, now = begin + clock.time, end = begin + clock.end;
    const slide = { k: "slide", id: "time", s: "", aria: "Time", value: now, low: begin, high: end, width: 0,
      text: `${now.toFixed(2)} s / ${end.toFixed(2)} s`, ticks: this.ticks };
    const buttons = [
      { k: "button", id: "pause", s: clock.isPlaying ? "pause" : "play", width: 3.4 },
      { k: "button", id: "start", s: "|<", tip: "go to the start", same: true },
      { k: "button", id: "back", s: "<", tip: "one frame back", same: true },
      { k: "button", id: "on", s: ">", tip: "one frame forward", same: true },
      { k: "choose", id: "speed", s: "", aria: "speed", same: true, width: 4.6, index: SPEEDS.indexOf(clock.speed),
        names: SPEEDS.map((speed) => `x ${speed}`) },
      { k: "check", id: "loop", s: "loop", on: clock.isLooping, same: true },
    ];
    return width < NARROW ? [slide, ...buttons] : [...buttons, { ...slide, same: true }];
  }

  #plotArea() {
    const { run, clock, chosen, plot } = this;
    const { findings, finding } = this, now = run.begin + clock.time;
    const names = [...run.joints.map(({ name }) => name), ...findings.map(({ text }) => text)];
    const index = finding < 0 ? chosen : run.joints.length + finding;
    const choice = { k: "choose", id: "joint", s: "", aria: "Joint", index, names, width: 11 };
    if (finding < 0) return { title: "Plot", name: "plot", nodes: [choice, { k: "plot", id: "plot", ...plot, name: names[chosen], now }] };
    const [overTime, overQuantity] = this.evidence, width = 0, name = names[index];
    return { title: "Plot", name: "plot", nodes: [choice, { k: "plot", id: "plot", ...overTime, name, now, width },
      { k: "plot", id: "over", ...overQuantity, name, width, same: this.width >= NARROW },
      { k: "text", s: (findings[finding].plot?.notes ?? []).join("\n") }] };
  }

  /** @returns {Node[]} */
  #help() {
    const keys = KEYS.filter(([key]) => key !== "q" || this.run.arrows.quantities.length);
    const rows = keys.map(([key, words]) => [[{ k: "text", s: key, mood: "key" }], [{ k: "text", s: words }]]);
    return [{ k: "title", s: "Mouse and keys" }, { k: "table", id: "keys", widths: [9, 0], rows }];
  }

  /** Returns the name and the values of the selected item, or null. */
  #details() {
    const { run, selected, clock: { frame } } = this;
    if (!selected) return null;
    const { joint: j = -1, body, kind, item = -1 } = selected, joint = j >= 0 ? run.joints[j] : null;
    /** @type {[string, string][]} */
    const rows = [];
    if (kind === VECTOR) {
      const entry = run.arrowTexts.find((each) => each.item === item);
      if (entry) rows.push(["value", entry.texts[entry.at[frame]]]);
      return { name: run.vectors[item], rows };
    }
    if (joint) {
      if (body && body !== joint.name) rows.push(["joint", joint.name]);
      const angle = valueOf(run, j, "joint_angles", frame);
      if (Number.isFinite(angle)) rows.push(["angle", `${fixed(angle, 3)} ${joint.angleUnit}`]);
      for (const line of joint.details) {
        const value = valueOf(run, j, line.key, frame);
        if (Number.isFinite(value)) rows.push([WORDS[line.label] || line.label, textOf(line, value)]);
      }
    }
    return { name: body || joint?.name || "overlay", rows };
  }
}

/** Returns the text below the title, with the size of the run and its expectations. @param {import("./data.js").Run} run */
function statusOf({ joints, frames, fps, marks, silent }) {
  const own = joints.filter((joint) => joint.double < 0).length;
  const about = [...(own ? [`${own} joints`] : []), frames > 1 ? `${((frames - 1) / fps).toFixed(1)} s` : "a pose"];
  const failed = marks.filter(({ kind }) => kind === "failed").length;
  const tested = failed + marks.filter(({ kind }) => kind === "held").length;
  const pieces = [[about.join(" · "), "dim"]];
  if (tested) pieces.push(failed ? [`${failed} of ${tested} expectations failed`, "bad"] : [`all ${tested} expectations held`, "dim"]);
  if (silent.length) pieces.push([`no data from ${silent.join(", ")}`, "dim"]);
  return pieces;
}

/**
 * Returns the marks of a run as ticks. Marks with a duration have a label.
 * @param {import("./data.js").Run} run
 * @returns {[number, string, string, number, string][]}
 */
function ticksOf({ marks, begin }) {
  return [...marks].sort((a, b) => a.begin - b.begin).map((mark) => {
    const outcome = mark.kind === "failed" || mark.kind === "held" ? `${mark.kind}: ` : "";
    const text = `${(begin + mark.begin).toFixed(2)} s: ${outcome}${mark.text}`;
    return [begin + mark.begin, mark.kind, text, begin + mark.end, mark.end > mark.begin ? mark.text : ""];
  });
}
