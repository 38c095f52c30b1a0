// The browser stores the look, light or dark, for all pages.
const isDark = matchMedia("(prefers-color-scheme: dark)");
const setLook = (look) => {
  document.documentElement.dataset.look = look;
  document.getElementById("look").textContent = look === "dark" ? "☀" : "☾";
};
setLook(localStorage.getItem("sero-mj look") ?? (isDark.matches ? "dark" : "light"));
document.getElementById("look").onclick = () => {
  const look = document.documentElement.dataset.look === "dark" ? "light" : "dark";
  localStorage.setItem("sero-mj look", look);
  setLook(look);
};

const add = (parent, kind, text = "", name = "") => {
  const made = parent.appendChild(document.createElement(kind));
  made.textContent = text;
  made.className = name;
  return made;
};
const line = new WebSocket(access.socket("/sero-mj/start"));
line.binaryType = "arraybuffer";
const send = (message) => line.send(JSON.stringify(message));
const lock = () => drops.notify(access.locked, true, 1e6);

// Only the browser in control can open a view or file.
let you = null, control = null;
const isInControl = () => you !== null && control?.holder === you.id;
const act = (message) => isInControl() ? send(message) : drops.notify("another browser has control");
Object.assign(drops, { may: isInControl, key: () => you?.key ?? "" });
document.getElementById("take").onclick = () => send({ t: "control" });

const search = document.getElementById("search");
search.oninput = async () => {
  const words = search.value, url = access.url("/sero-mj/tiles");
  url.searchParams.set("search", words);
  const answer = await fetch(url);
  if (answer.status === 403) return lock();
  const page = await answer.json();
  if (words !== search.value) return; // The text has changed since the request.
  document.querySelector("h1").textContent = page.title;
  search.placeholder = page.search;
  for (const [id, key] of [["tagline", "tagline"], ["hint", "drop"], ["more", "more"]]) {
    document.getElementById(id).textContent = page[key];
  }
  const all = document.getElementById("sections");
  all.replaceChildren();
  for (const { title, tiles } of page.sections) {
    add(all, "h2", title);
    const grid = add(all, "div", "", "tiles");
    for (const { number, title, about, has_picture } of tiles) {
      const tile = add(grid, "button");
      const image = add(tile, has_picture ? "img" : "div", "", has_picture ? "" : "none");
      if (has_picture) {
        image.loading = "lazy";
        image.alt = "";
        image.src = access.url(`/sero-mj/pictures/${number}`);
      }
      add(tile, "strong", title);
      add(tile, "span", about, "dim");
      tile.onclick = () => act({ t: "tile", number });
    }
  }
};
search.oninput();

let shownData = "";
function showData(awaited) {
  if (JSON.stringify(awaited) === shownData) return; // Buttons must not move under the pointer.
  shownData = JSON.stringify(awaited);
  const list = document.getElementById("data");
  list.replaceChildren();
  for (const { text, expected, command, mood, shown } of awaited) {
    const entry = add(list, "div", "", "awaited");
    add(entry, "p", text, mood);
    add(entry, "div", expected, "dim");
    for (const scene of shown) {
      const name = scene.split("/").pop();
      add(add(entry, "div"), "button", `show ${name}`, "small").onclick =
        () => act({ t: "shown", scene });
    }
    if (command === "") continue;
    const tried = add(entry, "div", `test with: ${command} `, "dim");
    add(tried, "button", "copy", "small").onclick = () =>
      navigator.clipboard?.writeText(command).catch(() => prompt("Ctrl+C copies", command));
  }
}

// A message has the length of a JSON text and then the text with the sections, see `sections.py`.
line.onmessage = ({ data }) => {
  const length = new DataView(data).getUint32(0, true);
  const { json } = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  send({ t: "got" });
  you = json.you ?? you;
  if (json.control) {
    const isFirst = control === null;
    control = json.control;
    if (isFirst && !isInControl() && access.hadControl()) send({ t: "control" });
    else access.noteControl(isInControl());
  }
  document.getElementById("control").hidden = you === null || control === null || isInControl();
  if (json.awaited) showData(json.awaited);
  if (json.notice) drops.notify(json.notice.text, json.notice.isBad, json.notice.seconds);
};
// After the start page, the server serves the chosen scene at the same address.
const OPENING_TIME = 20; // maximum time until the scene is served, s
line.onclose = async () => {
  const begin = performance.now();
  if (you !== null) drops.notify("opening ...", false, OPENING_TIME);
  for (let isReported = false;;) {
    const page = await access.page();
    if (page === "locked") {
      lock();
      await access.unlocked();
    } else if (page !== "") return location.reload();
    else if (!isReported && performance.now() - begin > 1000 * OPENING_TIME) {
      drops.notify("sero-mj is not running", true, 3600);
      isReported = true;
    }
    await new Promise((done) => setTimeout(done, 250));
  }
};
for (const id of ["files", "folder"]) {
  document.getElementById(id).onchange = ({ target }) => {
    const path = (file) => file.webkitRelativePath || file.name;
    drops.take([...target.files].map((file) => ({ path: path(file), file })));
    target.value = ""; // Otherwise, the same file could not be chosen again.
  };
}
