// Light or dark, which the browser keeps for all pages.
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
const of = (path) => path + location.search; // with the token, if there is one
const line = new WebSocket(
  Object.assign(new URL(of("/sero-mj/start"), location.href), { protocol: "ws:" }));
const send = (message) => line.send(JSON.stringify(message));

const search = document.getElementById("search");
search.oninput = async () => {
  const words = search.value, url = new URL(of("/sero-mj/tiles"), location.href);
  url.searchParams.set("search", words);
  const page = await (await fetch(url)).json();
  if (words !== search.value) return; // more was typed meanwhile
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
      const picture = add(tile, has_picture ? "img" : "div", "", has_picture ? "" : "none");
      if (has_picture) {
        picture.loading = "lazy";
        picture.alt = "";
        picture.src = of(`/sero-mj/pictures/${number}`);
      }
      add(tile, "strong", title);
      add(tile, "span", about, "dim");
      tile.onclick = () => send({ tile: number });
    }
  }
};
search.oninput();

let shownData = "";
function showData(awaited) {
  if (JSON.stringify(awaited) === shownData) return; // so that buttons stay under the pointer
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
        () => send({ shown: scene });
    }
    if (command === "") continue;
    const tried = add(entry, "div", `try ${command} `, "dim");
    add(tried, "button", "copy", "small").onclick = () =>
      navigator.clipboard?.writeText(command).catch(() => prompt("Ctrl+C copies", command));
  }
}

line.onmessage = ({ data }) => {
  const { awaited, notice, is_bad, seconds } = JSON.parse(data);
  if (awaited) showData(awaited);
  if (notice) drops.tell(notice, is_bad, seconds);
};
// What was chosen is soon served at this address.
const SOON = 20; // s
line.onclose = async () => {
  const begin = performance.now();
  drops.tell("opening ...", false, SOON);
  for (let isTold = false;;) {
    await new Promise((done) => setTimeout(done, 250));
    const page = await fetch(location.href).catch(() => null);
    if (page?.ok) return location.reload();
    if (isTold || performance.now() - begin < 1000 * SOON) continue;
    drops.tell("sero-mj has ended", true, 3600);
    isTold = true;
  }
};
for (const id of ["files", "folder"]) {
  document.getElementById(id).onchange = ({ target }) => {
    const path = (file) => file.webkitRelativePath || file.name;
    drops.take([...target.files].map((file) => ({ path: path(file), file })));
    target.value = ""; // the same may be chosen again
  };
}
