// The secret token of a page, see `guard.py`. A link brings it; this browser stores it for reloads
// and further tabs, and the address bar loses it.
var access = { locked: "This page is locked. Open the link that sero-mj printed where it was started: "
  + "the link contains the token of this page." };
{
  const STORED = "sero-mj token";
  const address = new URL(location.href);
  const given = address.searchParams.get("token") ?? "";
  try {
    if (given !== "") {
      localStorage.setItem(STORED, given);
      address.searchParams.delete("token");
      history.replaceState(null, "", address);
    }
  } catch { /* The browser stores nothing, so the token stays in the address. */ }
  // Another tab may have stored the token of a server that was started later.
  access.token = () => {
    try {
      return localStorage.getItem(STORED) ?? given;
    } catch {
      return given;
    }
  };
}
access.url = function (path) {
  const url = new URL(path, location.origin), token = access.token();
  if (token !== "") url.searchParams.set("token", token);
  return url;
};
access.socket = function (path) {
  const url = access.url(path);
  url.protocol = url.protocol.replace("http", "ws");
  return url;
};
// Resolves when another tab has stored another token.
access.unlocked = () => new Promise((done) => addEventListener("storage", done, { once: true }));
// Whether this tab was in control before a reload, or of the page that was served before.
access.hadControl = function () {
  try {
    return sessionStorage.getItem("sero-mj control") === "1";
  } catch {
    return false;
  }
};
access.noteControl = function (isInControl) {
  try {
    sessionStorage.setItem("sero-mj control", isInControl ? "1" : "");
  } catch { /* The browser stores nothing, so the first one that comes back has control. */ }
};
// Returns which page is served now, "locked" without a valid token, or "" without an answer.
access.page = async function () {
  try {
    const answer = await fetch(access.url("/sero-mj/page"));
    if (answer.status === 403) return "locked";
    return (await answer.json()).page;
  } catch {
    return "";
  }
};
