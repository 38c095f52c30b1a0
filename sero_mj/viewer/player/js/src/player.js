/** The page, which shows the state that the transport receives, and sends the user's actions. */

import { isOnHandle } from "./handles.js";
import { Input } from "./input.js";
import { lookIn, lookToOpen, onOtherLook } from "./look.js";
import { byId, valueIn } from "./page.js";
import { Recording } from "./recording.js";
import { readSections } from "./sections.js";
import { State } from "./state.js";
import { Surround } from "./surround.js";
import { SocketTransport, accessOf } from "./transport.js";
import { View, showProblem } from "./view.js";

/** @typedef {import("./transport.js").Transport} Transport */
/** @typedef {import("./eye.js").View & {by: unknown, serial: number, fixed: number}} SentCamera */

const LOOK = "sero-mj look"; // key in localStorage
// These JSON sections affect the image.
const IN_IMAGE = ["labels", "cards", "camera", "lookAt", "selected", "shading"];

/** The player on a page. */
export class Player {
  /** @param {Transport} transport connection of a live page, or a `Recording` */
  constructor(transport = new SocketTransport("/live", accessOf())) {
    this.transport = transport;
    /** Latest values of received sections that are not shown yet. @type {import("./sections.js").Sections} */
    this.waiting = { json: new Map(), bytes: new Map() };
    this.unanswered = 0; // number of messages that are not shown yet, which the server limits
    this.serial = -1; // number of the last camera motion by the server
    /** Latest values of sections that are read later. @type {Record<string, any>} */
    this.now = {};
    this.recording = transport instanceof Recording ? transport : null;
    /** @type {State | Recording | null} */
    this.state = null;
    this.isFollowing = true; // whether this page shows the camera of the browser in control
    this.isTurned = false; // whether the user has rotated the camera since it was last sent
    this.surround = new Surround((message) => this.#act(message));
    this.view = new View({
      frame: (passed) => this.#frame(passed),
      clickText: (key, event) => this.#clickText(key, event),
      turn: (isUser) => { if (isUser) this.#turned(); },
      look: () => {},
      resize: () => this.#sendSize(),
    });
    this.view.labels.onClick = (key, event) => this.#clickText(key, event);
    document.body.classList.add(this.recording ? "file" : "live");
    this.view.setLook(lookToOpen(this.#storedLook()));
    this.input = new Input(this.view.renderer.domElement, {
      send: (message) => this.#act(message),
      canAct: () => this.isInControl,
      isDragging: () => Boolean(this.now.dragging),
      isOnHandle: (at, tolerance) => Boolean(this.view.current && this.state
        && isOnHandle(this.view.stage, this.state.geoms, at, tolerance)),
      isOnSomething: ({ x, y }) => Boolean(this.view.current && this.view.stage.pick(x, y)),
      setTurning: (isOn) => { if (this.view.current) this.view.stage.orbit.enabled = isOn && !this.now.dragging; },
      localKey: (name) => this.#localKey(name),
      wake: () => this.view.wake(false),
    });
    this.#listen();
    // A separate script, `uploads.js`, sends dropped files.
    Object.assign(/** @type {any} */ (globalThis).drops ?? {},
      { may: () => this.isInControl, key: () => this.now.you?.key ?? "" });
    this.#connect();
  }

  get stage() { return this.view.stage; }

  get run() { return this.view.stage.run; }

  get calls() { return this.view.calls; }

  /** Returns the look that the user has chosen on a page of this server, or null. */
  #storedLook() { return this.recording ? null : storedLook(); }

  /** Whether this browser is in control. */
  get isInControl() {
    return this.now.you !== undefined && this.now.control?.holder === this.now.you.id;
  }

  #connect() {
    const { transport } = this;
    transport.onopen = () => {
      showProblem("server", "");
      this.waiting = { json: new Map(), bytes: new Map() };
      this.unanswered = 0;
      this.serial = -1;
      this.now = {};
      this.isNew = true;
      if (this.recording) this.#show(this.recording);
      this.#sendSize();
    };
    transport.onframe = () => this.view.wake();
    transport.onclose = () => showProblem("server", "The viewer is not running. This page reconnects when it runs again.");
    transport.onlocked = () => showProblem("server", accessOf().locked);
    transport.onmessage = (message) => {
      if (typeof message === "string") this.#event(JSON.parse(message));
      else this.#receive(message);
    };
    transport.onother = () => location.reload();
    transport.open();
  }

  #listen() {
    const press = (/** @type {string} */ id, /** @type {() => void} */ act) => byId(id).addEventListener("click", act);
    press("look", () => { if (!this.recording) storeLook(this.view.look); });
    press("open", () => this.#act({ t: "key", key: "t", repeat: false }));
    press("help", () => this.#act({ t: "key", key: "h", repeat: false }));
    press("take", () => this.#takeControl());
    press("follow", () => {
      this.isFollowing = true;
      this.#useCamera(this.now.camera);
      this.#showControl();
    });
    byId("camera").addEventListener("change", (event) => this.#chooseCamera(Number(valueIn(event))));
    onOtherLook(() => this.view.setLook(lookToOpen(this.#storedLook())));
  }

  /** @param {ArrayBuffer | import("./sections.js").Sections} message */
  #receive(message) {
    const { waiting } = this;
    this.unanswered++;
    try {
      const { json, bytes } = message instanceof ArrayBuffer ? readSections(message) : message;
      // Waiting sections belong to the previous model.
      if (bytes.has("run")) waiting.bytes.clear();
      for (const [name, value] of json) waiting.json.set(name, value);
      for (const [name, value] of bytes) waiting.bytes.set(name, value);
    } catch (error) {
      reportInvalid(error);
    }
    this.view.wake(false);
  }

  /** @param {{copy?: string, reload?: boolean}} event */
  #event({ copy, reload }) {
    if (copy !== undefined) navigator.clipboard?.writeText(copy).catch(() => prompt("Copy:", copy)) ?? prompt("Copy:", copy);
    if (reload) location.reload();
  }

  /** Applies the received sections. */
  #take() {
    const { json, bytes } = this.waiting;
    if (!json.size && !bytes.size) return;
    this.waiting = { json: new Map(), bytes: new Map() };
    try {
      const run = bytes.get("run");
      if (run) this.#show(new State(run, this.state instanceof State ? this.state.keys : []));
      for (const [name, value] of json) this.#takeJson(name, value);
      if (this.state instanceof State) for (const [name, value] of bytes) if (this.state.take(name, value)) this.view.isDirty = true;
    } catch (error) {
      reportInvalid(error);
    }
  }

  /** @param {State | Recording} state */
  #show(state) {
    this.state = state;
    this.view.show(state.run);
    if (this.recording) this.recording.stage = this.stage;
    this.stage.robots.shade(this.now.shading ?? {});
  }

  /** @param {string} name @param {any} value */
  #takeJson(name, value) {
    if (this.state instanceof State && this.state.takeJson(name, value)) this.view.isDirty = true;
    if (name === "hover" && !this.isInControl) return; // The name is at the pointer of another browser.
    if (name === "request") {
      this.now.request = value;
      this.#showRequest();
      return;
    }
    if (this.surround.take(name, value)) return;
    const before = this.now[name];
    this.now[name] = value;
    if (IN_IMAGE.includes(name)) this.view.isDirty = true;
    switch (name) {
      case "camera": this.#follow(value); break;
      case "lookAt": this.#shift(before, value); break;
      case "shading": this.view.current?.robots.shade(value ?? {}); break;
      case "you": case "control":
        this.#restoreControl();
        this.#showControl();
        break;
      case "dragging": case "onHandle": this.#showCursor(); break;
    }
  }

  /** Draws a frame immediately. */
  draw() {
    this.view.isDirty = true;
    this.#frame(0);
  }

  /** @param {number} passed ms since the last frame */
  #frame(passed) {
    this.recording?.advance(passed);
    this.#take();
    this.#sendCamera();
    this.input.flush();
    for (; this.unanswered; this.unanswered--) this.transport.send('{"t":"got"}');
    const { state, view } = this;
    if (!state || !view.isDirty) return;
    view.stage.notePace(passed);
    view.draw(state.moment(view.stage, this.now));
  }

  /** Sends a message if this browser is in control. @param {object} message */
  #act(message) {
    if (!this.isInControl) return;
    this.#sendCamera();
    this.transport.send(JSON.stringify(message));
  }

  #sendSize() {
    const { clientWidth, clientHeight } = byId("stage");
    this.transport.send(JSON.stringify({ t: "size", w: clientWidth, h: clientHeight, page: innerWidth }));
  }

  /** Sends the camera to the server if the user has rotated it. */
  #sendCamera() {
    if (!this.isTurned || !this.isInControl || !this.view.current) return;
    this.isTurned = false;
    this.transport.send(JSON.stringify({ t: "camera", fixed: this.stage.fixed, ...this.stage.view }));
  }

  /** Handles a rotation of the camera by the user. */
  #turned() {
    this.isTurned = true;
    if (this.isInControl || !this.isFollowing) return;
    this.isFollowing = false;
    this.#showControl();
  }

  /** Uses the camera of another browser or of the server. @param {SentCamera} camera */
  #follow(camera) {
    if (!camera) return;
    const isOwn = camera.by === this.now.you?.id && camera.serial === this.serial;
    this.serial = camera.serial;
    if (!isOwn && (this.isFollowing || this.isInControl)) this.#useCamera(camera);
  }

  /** @param {SentCamera | undefined} camera */
  #useCamera(camera) {
    if (!camera || !this.view.current) return;
    if (camera.fixed >= 0 || this.recording) this.stage.chooseCamera(camera.fixed);
    else this.stage.look(camera);
    this.view.wake();
  }

  /** Moves the camera with the followed frame. @param {number[] | null} before @param {number[] | null} now */
  #shift(before, now) {
    if (!before || !now || !this.view.current || this.stage.fixed >= 0) return;
    this.stage.shift(now.map((each, k) => each - before[k]));
  }

  /** @param {number} number -1 for the scene's view */
  #chooseCamera(number) {
    if (this.isInControl && number < 9) return this.#act({ t: "key", key: String(number + 1), repeat: false });
    this.stage.chooseCamera(number);
    this.#turned();
    return this.view.wake();
  }

  /** Performs the action of a key that works without control. @param {string} name */
  #localKey(name) {
    if (!/^\d$/.test(name) || !this.view.current) return false;
    this.#chooseCamera(Number(name) - 1);
    return true;
  }

  /** Sends a click on a text over the image. @param {string} key kind and item @param {MouseEvent} event */
  #clickText(key, event) {
    const [kind, item] = key.split(" ").map(Number), at = this.input.pixelOf(event);
    this.#act({ t: "card", kind, item, ...at, shift: event.shiftKey || event.ctrlKey });
  }

  /** Shows which browser is in control, if there are several. */
  #showControl() {
    const { control, you } = this.now, { isInControl } = this;
    document.body.classList.toggle("watching", Boolean(you && control && !isInControl));
    const isShared = (control?.count ?? 1) > 1;
    byId("control").hidden = !isShared && isInControl;
    byId("who").textContent = isInControl ? `in control · ${control?.count} browsers` : "another browser is in control";
    byId("take").hidden = isInControl;
    byId("follow").hidden = isInControl || this.isFollowing;
    this.#showRequest();
    if (!isInControl || this.wasInControl) {
      this.wasInControl = isInControl;
      return;
    }
    this.wasInControl = true;
    this.isFollowing = true;
    if (isShared && this.isTurned) this.#sendCamera(); // Other browsers follow this one.
    const view = new URLSearchParams(location.hash.slice(1)).get("view");
    if (view && !this.hasSentView) this.transport.send(JSON.stringify({ t: "view", text: view }));
    this.hasSentView = true;
  }

  /** Shows the dialog about programs of a file in the browser in control. */
  #showRequest() {
    const { request } = this.now;
    if (request) byId("asks").textContent = request.title;
    this.surround.request.show(this.isInControl && request ? request.nodes : null);
  }

  /** Takes control again after a reload, or on the next page of the server. */
  #restoreControl() {
    const { control, you } = this.now, { transport } = this;
    if (!you || !control) return;
    if (this.isNew && !this.isInControl && transport.hadControl()) this.#takeControl();
    else transport.noteControl(this.isInControl);
    this.isNew = false;
  }

  #takeControl() { this.transport.send(JSON.stringify({ t: "control" })); }

  isNew = true; // whether it is still unknown which browser is in control
  wasInControl = false;
  hasSentView = false; // whether the view in the link was sent

  /** Sets the shape of the pointer. */
  #showCursor() {
    const { dragging, onHandle } = this.now, canvas = this.view.renderer.domElement;
    canvas.style.cursor = dragging ? "grabbing" : onHandle ? "grab" : "";
    if (this.view.current) this.stage.orbit.enabled = !dragging;
  }
}

/** @param {unknown} error */
function reportInvalid(error) {
  console.warn("from the server:", error);
  showProblem("message", "This page does not match its server. Reload it.");
}

/** @param {import("./view.js").Look} look */
function storeLook(look) {
  try {
    localStorage.setItem(LOOK, look);
  } catch { /* The browser does not store data. */ }
}

/** Returns the look that the user has chosen on a page of this server, or null. */
function storedLook() {
  try {
    return lookIn(localStorage.getItem(LOOK));
  } catch { // The browser does not store data.
    return null;
  }
}
