/** Sends pointer, wheel and key events over the image of a live page to the server. */

import { isTakenBy, nameOf } from "./keys.js";

/** @typedef {{x: number, y: number}} Pixel distance from the upper left corner of the image */

/**
 * The functions of the page that `Input` calls.
 * @typedef {{send: (message: object) => void, canAct: () => boolean, isDragging: () => boolean,
 *   isOnHandle: (at: Pixel, tolerance: number) => boolean, isOnSomething: (at: Pixel) => boolean, setTurning: (isOn: boolean) => void,
 *   localKey: (name: string) => boolean, wake: () => void}} Page
 *   canAct: returns whether this browser is in control; setTurning: sets whether drags rotate the camera;
 *   localKey: performs the action of a key without the server, and returns whether there is one
 */

const HOLD = 500; // time after which a finger that does not move grabs a link, ms
const STILL = 8; // maximum motion of a finger that does not move, pixels
const TOLERANCE = 4, FINGER = 12; // tolerances around a handle for a mouse and for a finger, pixels
const STEP = 100, LINES = 3; // number of screen pixels or lines per notch of a wheel
/** For each button number of the browser: the number in messages. */
const BUTTONS = [0, 2, 1];

/**
 * Returns the number of notches of a wheel event, positive away from the user.
 *
 * The number does not depend on the screen and on the zoom of the page.
 * @param {{deltaMode: number, deltaY: number}} event @param {number} ratio pixels of the screen per pixel of the page
 */
export const stepsOf = ({ deltaMode, deltaY }, ratio) => -deltaY * (deltaMode ? 1 / LINES : ratio / STEP);

/** Sends the user's input on a live page to the server. */
export class Input {
  /** @param {HTMLCanvasElement} canvas @param {Page} page */
  constructor(canvas, page) {
    this.canvas = canvas;
    this.page = page;
    /** @type {PointerEvent | null} */
    this.moved = null;
    /** @type {Set<number>} */
    this.fingers = new Set();
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.hold = undefined;
    this.from = { x: 0, y: 0 }; // position at which a finger was put down
    this.isPressed = false;
    this.isOver = false; // whether the server has received a pointer position over the image
    /** @type {[keyof HTMLElementEventMap, (event: any) => void][]} */
    const listeners = [["pointerdown", (event) => this.#press(event)], ["pointermove", (event) => this.#move(event)],
      ["pointerup", (event) => this.#release(event)], ["pointercancel", (event) => this.#cancel(event)],
      ["pointerenter", (event) => this.#enter(event)], ["pointerleave", (event) => this.#leave(event)]];
    // These listeners must be called before those of the camera controls, which depend on `setTurning`.
    for (const [name, listener] of listeners) canvas.addEventListener(name, listener, { capture: true, passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    addEventListener("keydown", (event) => this.#key(event));
    // During a drag, the wheel changes the dragged item, wherever the pointer is on the page.
    addEventListener("wheel", (event) => this.#wheel(event), { capture: true, passive: false });
  }

  /** Returns the pixel of an event. If a key has caused the click, this is the center of the element. @param {MouseEvent} event @returns {Pixel} */
  pixelOf({ clientX, clientY, detail, type, target }) {
    const { left, top } = this.canvas.getBoundingClientRect();
    if (type !== "click" || detail) return { x: clientX - left, y: clientY - top };
    const box = /** @type {Element} */ (target).getBoundingClientRect();
    return { x: (box.left + box.right) / 2 - left, y: (box.top + box.bottom) / 2 - top };
  }

  /** @param {string} kind @param {PointerEvent} event */
  #send(kind, event) {
    if (!this.page.canAct()) return;
    if (kind !== "move") this.flush();
    this.isOver = kind !== "leave";
    this.page.send({ t: "pointer", kind, ...this.pixelOf(event), button: BUTTONS[event.button] ?? 0,
      shift: event.shiftKey || event.ctrlKey || event.metaKey, ctrl: event.ctrlKey || event.metaKey });
  }

  /** Sends the last motion of the pointer that was not sent yet. */
  flush() {
    const event = this.moved;
    this.moved = null;
    if (event) this.#send("move", event);
  }

  /** @param {PointerEvent} event */
  #press(event) {
    const isFinger = event.pointerType === "touch", at = this.pixelOf(event);
    this.fingers.add(event.pointerId);
    if (this.fingers.size > 1) { // Two fingers zoom.
      this.#cancel(event);
      this.fingers.add(event.pointerId);
      this.page.setTurning(true);
      return;
    }
    const isOurs = this.page.canAct() && event.button === 0 && (event.ctrlKey || event.metaKey
      || this.page.isOnHandle(at, isFinger ? FINGER : TOLERANCE));
    this.page.setTurning(!isOurs);
    this.canvas.setPointerCapture(event.pointerId);
    this.isPressed = true;
    this.#send("press", event);
    if (!isFinger) return;
    this.from = at;
    this.hold = setTimeout(() => {
      if (!this.page.canAct()) return;
      if (this.page.isOnSomething(at)) this.page.setTurning(false); // The answer of the server would be too late.
      this.page.send({ t: "hold" });
    }, HOLD);
  }

  /** @param {PointerEvent} event */
  #move(event) {
    if (this.fingers.size > 1) return;
    const { x, y } = this.pixelOf(event);
    if (Math.hypot(x - this.from.x, y - this.from.y) > STILL) clearTimeout(this.hold);
    this.moved = event;
    this.page.wake();
  }

  /** @param {PointerEvent} event */
  #release(event) {
    this.fingers.delete(event.pointerId);
    clearTimeout(this.hold);
    if (!this.isPressed) return;
    this.isPressed = false;
    this.#send("release", event);
    // The camera controls must handle the event before.
    setTimeout(() => this.page.setTurning(true));
  }

  /** Cancels a drag, because there is a second finger or the browser handles the gesture. @param {PointerEvent} event */
  #cancel(event) {
    this.fingers.delete(event.pointerId);
    clearTimeout(this.hold);
    this.moved = null;
    if (this.isPressed) this.#send("leave", event);
    this.isPressed = false;
  }

  /** Handles the pointer when it enters the image, for example because a covering element has disappeared. @param {PointerEvent} event */
  #enter(event) {
    if (event.pointerType === "mouse") this.#move(event);
  }

  /** @param {PointerEvent} event */
  #leave(event) {
    if (this.isPressed) return;
    this.moved = null;
    if (this.isOver) this.#send("leave", event);
  }

  /** @param {WheelEvent} event */
  #wheel(event) {
    if (!this.page.isDragging()) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    this.page.send({ t: "wheel", n: stepsOf(event, devicePixelRatio) });
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const name = nameOf(event), element = /** @type {HTMLInputElement} */ (event.target);
    if (!name || event.defaultPrevented || isTakenBy(element, event.key)) return;
    if (name === "ctrl+c" && String(getSelection())) return;
    if (document.querySelector("dialog[open]") && name !== "h") return;
    if (!this.page.canAct()) {
      if (this.page.localKey(name)) event.preventDefault();
      return;
    }
    event.preventDefault();
    this.flush();
    this.page.send({ t: "key", key: name, repeat: event.repeat });
  }
}
