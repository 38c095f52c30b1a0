import js from "@eslint/js";
import globals from "globals";

export default [
  js.configs.recommended,
  {
    languageOptions: { ecmaVersion: 2022, globals: { ...globals.browser, ...globals.node } },
    rules: { eqeqeq: "error", "no-var": "error", "prefer-const": "error" },
  },
  {
    // These files are scripts, not modules, and share access to the server in global variables.
    files: ["web/static/*.js"],
    languageOptions: { sourceType: "script", globals: { access: "writable", drops: "writable" } },
    rules: { "no-var": "off", "no-redeclare": "off" },
  },
];
