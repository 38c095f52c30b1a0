/** The names of keys in messages to the server, and the keys that are left to the browser. */

/** @type {Record<string, string>} */
const NAMED = { ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down", Escape: "escape",
  Backspace: "backspace", Delete: "delete", Home: "home", End: "end", F1: "f1", F2: "f2", F3: "f3" };
const WITH_CONTROL = ["z", "y", "c"];
// Elements of a page handle these keys.
const OF_BUTTONS = [" ", "Enter"];
const OF_SLIDERS = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown"];

/**
 * Returns the name of a key, or an empty string for a key of the browser.
 * @param {Pick<KeyboardEvent, "key" | "ctrlKey" | "metaKey" | "altKey" | "shiftKey">} event
 */
export function nameOf({ key, ctrlKey, metaKey, altKey, shiftKey }) {
  const isCharacter = [...key].length === 1, low = key.toLowerCase();
  if (altKey && !isCharacter) return "";
  if (ctrlKey || metaKey) {
    if (altKey) return isCharacter && key !== low ? "" : isCharacter ? low : ""; // AltGr
    if (low === "z" && shiftKey) return "ctrl+y";
    return WITH_CONTROL.includes(low) ? `ctrl+${low}` : "";
  }
  return isCharacter ? low : NAMED[key] ?? "";
}

/**
 * Returns whether the focused element handles a key.
 * @param {{tagName: string, type?: string}} element @param {string} key as in a KeyboardEvent
 */
export function isTakenBy({ tagName, type }, key) {
  switch (tagName) {
    case "TEXTAREA": case "SELECT": return true;
    case "INPUT":
      if (type === "range") return OF_SLIDERS.includes(key);
      return type !== "checkbox" || OF_BUTTONS.includes(key);
    case "BUTTON": case "SUMMARY": return OF_BUTTONS.includes(key);
    default: return false;
  }
}
