/** The look of a page, light or dark, which the scene, the user or the browser determines. */

/** @typedef {import("./view.js").Look} Look */

const isDark = matchMedia("(prefers-color-scheme: dark)");

/** @param {unknown} text @returns {Look | null} */
export const lookIn = (text) => text === "light" || text === "dark" ? text : null;

const requested = lookIn(document.documentElement.dataset.look); // The player later stores the displayed look in this attribute.

/** Returns the initial look of a page. @param {Look | null} [chosen] look that the user has chosen before */
export const lookToOpen = (chosen = null) => requested ?? chosen ?? (isDark.matches ? "dark" : "light");

/** Calls a function when the browser's look changes, unless the page requests one. @param {() => void} act */
export const onOtherLook = (act) => isDark.addEventListener("change", () => { if (!requested) act(); });
