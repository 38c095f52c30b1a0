/** Draws the image of a page and the text over it. */

import { Billboards } from "./billboards.js";
import { Labels } from "./labels.js";
import { boxesOf, byId, made } from "./page.js";
import { Stage, rendererOf } from "./stage.js";

/** @typedef {import("./data.js").Run} Run */
/** @typedef {"light" | "dark"} Look */

/**
 * The functions that a view calls.
 * @typedef {{frame: (passed: number) => void, clickText: (key: string, event: MouseEvent) => void,
 *   turn: (isUser: boolean) => void, look: (look: Look) => void, resize: () => void}} Acts
 *   frame: draws a frame; `passed` is the time since the last frame in ms, or 0 after a pause;
 *   turn: called when the camera has moved
 */

/**
 * The state to draw, with a frame of a run and the visible features.
 * @typedef {{at: number, hasDoubles: boolean,
 *   geoms: (sites: import("three").Matrix4[]) => import("./geoms.js").Geoms,
 *   billboards: () => import("./billboards.js").Content[], labels: import("./labels.js").Label[],
 *   sites?: {positions: Float32Array, turns: Float32Array} | null}} Moment
 */

/** The image of a page. */
export class View {
  /** @param {Acts} acts */
  constructor(acts) {
    this.acts = acts;
    this.renderer = rendererOf(byId("picture"));
    this.billboards = new Billboards(byId("cards"), byId("leaders"), acts.clickText);
    this.labels = new Labels(byId("stage"));
    /** @type {Stage | null} */
    this.current = null;
    this.calls = 0;
    this.before = 0; // time of the last frame, ms; 0 after a pause
    this.isAwake = false;
    this.isDirty = true; // whether the image has changed
    this.isUsers = false; // whether the user moves the camera
    /** @type {Look} */
    this.look = "light";
    this.#listen();
  }

  /** The stage of the displayed run. */
  get stage() {
    if (!this.current) throw new Error("nothing has been drawn yet");
    return this.current;
  }

  /** Shows a run instead of the previous one. @param {Run} run */
  show(run) {
    this.current?.dispose();
    const stage = this.current = new Stage(run, this.renderer);
    stage.orbit.addEventListener("start", () => {
      this.isUsers = true;
      stage.free();
    });
    stage.orbit.addEventListener("end", () => { this.isUsers = false; });
    stage.orbit.addEventListener("change", () => {
      this.acts.turn(this.isUsers);
      this.wake();
    });
    const cameras = byId("camera"), names = run.cameras.map(({ name }, k) => name || `camera ${k + 1}`);
    cameras.replaceChildren(...["view", ...names].map((name, k) => made("option", name, { value: String(k - 1) })));
    cameras.hidden = !names.length;
    this.setLook(this.look);
    this.resize();
  }

  #listen() {
    const canvas = this.renderer.domElement;
    byId("look").addEventListener("click", () => this.setLook(this.look === "dark" ? "light" : "dark"));
    new ResizeObserver(() => this.resize()).observe(byId("stage"));
    // Billboards cover the image, but the wheel still zooms it.
    byId("cards").addEventListener("wheel", (event) => {
      event.preventDefault();
      canvas.dispatchEvent(new WheelEvent("wheel", event));
    }, { passive: false });
    canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      showProblem("graphics", "The browser has suspended WebGL. The image returns when it is available again.");
    });
    canvas.addEventListener("webglcontextrestored", () => {
      showProblem("graphics", "");
      this.wake();
    });
  }

  /** @param {Look} look */
  setLook(look) {
    this.look = look;
    document.documentElement.dataset.look = look;
    byId("look").textContent = look === "dark" ? "☀" : "☾";
    this.current?.setLook(look);
    this.acts.look(look);
    this.wake();
  }

  resize() {
    const { clientWidth, clientHeight } = byId("stage");
    if (!clientWidth || !clientHeight) return;
    this.current?.resize(clientWidth, clientHeight);
    this.billboards.forgetSizes();
    this.acts.resize();
    this.wake();
  }

  /** Makes the browser call `frame` once before it draws again. @param {boolean} isDirty whether the image has changed */
  wake(isDirty = true) {
    this.isDirty ||= isDirty;
    if (this.isAwake) return;
    this.isAwake = true;
    requestAnimationFrame((time) => {
      const passed = this.before ? time - this.before : 0;
      this.isAwake = false;
      this.acts.frame(passed);
      this.before = this.isAwake ? time : 0;
    });
  }

  /** @param {Moment} moment */
  draw({ at, hasDoubles, geoms, billboards, labels, sites }) {
    const { stage } = this;
    this.isDirty = false;
    stage.place(at, hasDoubles, geoms, sites);
    this.calls = stage.draw();
    const { offsetTop, offsetHeight } = /** @type {HTMLElement} */ (byId("names").parentElement);
    const top = offsetTop + offsetHeight + 4;
    const room = byId("stage").getBoundingClientRect(), boxes = boxesOf(["#notes", "#details"]);
    const foot = Number(document.querySelector("#timeline .told")?.getAttribute("data-room") ?? 0);
    /** @param {number} left @param {number} right pixels */
    const endOf = (left, right) => Math.min(stage.size.height - foot - 8, ...boxes
      .filter((box) => box.left - room.left < right && box.right - room.left > left)
      .map((box) => box.top - room.top - 8));
    this.billboards.layOut(stage, billboards(), top, endOf);
    this.labels.layOut(stage, labels);
    /** @type {HTMLSelectElement} */ (byId("camera")).value = String(stage.fixed);
  }
}

/** Displayed problems by topic. @type {Map<string, string>} */
const problems = new Map();

/** Shows a problem over the image. @param {string} what topic @param {string} text an empty string removes the problem */
export function showProblem(what, text) {
  if (text) problems.set(what, text);
  else problems.delete(what);
  byId("problem").textContent = [...problems.values()].join("\n");
  byId("problem").hidden = !problems.size;
}
