/** Light or dark: as it was asked for where the page was made, as its user has chosen, else as the browser has it. */

/** @typedef {import("./view.js").Look} Look */

const isDark = matchMedia("(prefers-color-scheme: dark)");

/** @param {unknown} text @returns {Look | null} */
export const lookIn = (text) => text === "light" || text === "dark" ? text : null;

const asked = lookIn(document.documentElement.dataset.look); // before it is what is shown

/** The look to open a page in. @param {Look | null} [chosen] by its user, before */
export const lookToOpen = (chosen = null) => asked ?? chosen ?? (isDark.matches ? "dark" : "light");

/** Calls when the browser has another look, unless one was asked for. @param {() => void} act */
export const onOtherLook = (act) => isDark.addEventListener("change", () => { if (!asked) act(); });
