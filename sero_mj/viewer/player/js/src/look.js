/** Light or dark: as requested for the page, as chosen by the user, or as set in the browser. */

/** @typedef {import("./view.js").Look} Look */

const isDark = matchMedia("(prefers-color-scheme: dark)");

/** @param {unknown} text @returns {Look | null} */
export const lookIn = (text) => text === "light" || text === "dark" ? text : null;

const asked = lookIn(document.documentElement.dataset.look); // read before it is set to the displayed look

/** Returns the initial look of a page. @param {Look | null} [chosen] earlier by the user */
export const lookToOpen = (chosen = null) => asked ?? chosen ?? (isDark.matches ? "dark" : "light");

/** Calls a function when the browser's look changes, unless the page requests one. @param {() => void} act */
export const onOtherLook = (act) => isDark.addEventListener("change", () => { if (!asked) act(); });
