// The secret token of a page, see `guard.py`, is in the link. This script stores it for reloads and
// further tabs, and removes it from the address bar.
var access = { locked: "This page is locked. Open the link that sero-mj printed when it was started. "
  + "The link contains the token of this page." };
{
  const STORED = "sero-mj token";
  const address = new URL(location.href);
  const inLink = address.searchParams.get("token") ?? "";
  try {
    if (inLink !== "") {
      localStorage.setItem(STORED, inLink);
      address.searchParams.delete("token");
      history.replaceState(null, "", address);
    }
  } catch { /* The browser does not store data, so the token remains in the address. */ }
  // Another tab may have stored the token of a server that was started later.
  access.token = () => {
    try {
      return localStorage.getItem(STORED) ?? inLink;
    } catch {
      return inLink;
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
// Returns whether this tab was in control before a reload, or in control of the previous page.
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
  } catch { /* The browser does not store data, so the first browser that reconnects gets control. */ }
};
// Returns the name of the page that is served now, "locked" without a valid token, or "" without an answer.
access.page = async function () {
  try {
    const answer = await fetch(access.url("/sero-mj/page"));
    if (answer.status === 403) return "locked";
    return (await answer.json()).page;
  } catch {
    return "";
  }
};
