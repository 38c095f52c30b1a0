// Sends dropped files, and folders with their contents, to the page's server.
const CHUNK = 262144; // size of a part of a file, bytes
// `may` returns whether this browser is in control, and `key` returns the key of its connection.
var drops = { may: () => true, key: () => "", text: "" };
drops.notify = function (text, isBad = true, seconds = 12) {
  let box = document.getElementById("sero-told");
  if (box === null) {
    box = document.body.appendChild(document.createElement("div"));
    box.id = "sero-told";
  }
  drops.text = box.textContent = text;
  box.style.color = isBad ? "#ff8a73" : "#9fd8a4";
  box.style.display = text === "" ? "none" : "block";
  clearTimeout(drops.timer);
  drops.timer = setTimeout(() => drops.notify(""), 1000 * seconds);
};
drops.show = function (isShown) {
  let cover = document.getElementById("sero-drop");
  if (cover === null) {
    cover = document.body.appendChild(document.createElement("div"));
    cover.id = "sero-drop";
    cover.textContent = "drop to open";
  }
  cover.style.display = isShown ? "flex" : "none";
};
// Returns all files of a dropped folder, or a dropped file.
drops.inside = async function (entry) {
  if (entry.isFile) {
    const file = await new Promise((done, failed) => entry.file(done, failed));
    return [{ path: entry.fullPath.replace(/^\//, ""), file }];
  }
  const reader = entry.createReader(), found = [];
  for (;;) { // A reader returns a few entries per call.
    const some = await new Promise((done, failed) => reader.readEntries(done, failed));
    if (some.length === 0) return found;
    for (const each of some) found.push(...await drops.inside(each));
  }
};
drops.send = async function (files) {
  const line = new WebSocket(access.socket("/sero-mj/files"));
  line.onmessage = ({ data }) => {
    const { error, opening } = JSON.parse(data);
    if (error) drops.notify(error); else drops.notify(`opening ${opening} ...`, false, 4);
    line.close();
  };
  await new Promise((done, failed) => { line.onopen = done; line.onerror = failed; });
  const listed = files.map(({ path, file }) => ({ path, size: file.size }));
  line.send(JSON.stringify({ key: drops.key(), files: listed }));
  for (const { file } of files) {
    for (let at = 0; at < file.size; at += CHUNK) {
      const part = await file.slice(at, at + CHUNK).arrayBuffer();
      while (line.bufferedAmount > 16 * CHUNK) await new Promise(r => setTimeout(r, 5));
      if (line.readyState !== WebSocket.OPEN) return;
      line.send(part);
    }
  }
};
drops.take = async function (files) {
  if (!drops.may()) return drops.notify("another browser has control of this page");
  try {
    await drops.send(files);
  } catch (error) {
    drops.notify(`the files could not be sent: ${error.message || "no connection"}`);
  }
};
for (const kind of ["dragenter", "dragover", "dragleave", "drop"]) {
  window.addEventListener(kind, async (event) => {
    if (![...(event.dataTransfer?.types ?? [])].includes("Files")) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    drops.show(kind === "dragenter" || kind === "dragover");
    if (kind !== "drop") return;
    const items = [...event.dataTransfer.items].filter(({ kind }) => kind === "file");
    const entries = items.map((item) => item.webkitGetAsEntry?.() ?? null);
    const plain = items.map((item) => item.getAsFile()); // This works only during the event.
    const files = [];
    for (const [k, entry] of entries.entries()) {
      if (entry !== null) files.push(...await drops.inside(entry));
      else if (plain[k] !== null) files.push({ path: plain[k].name, file: plain[k] });
    }
    drops.take(files);
  }, { capture: true });
}
