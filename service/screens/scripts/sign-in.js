/** The page that exchanges the token of a key for a session of this browser. */

import { post } from "./api.js";
import { byId, setText } from "./dom.js";
import { mountHeader } from "./header.js";
import { loadWords, word } from "./words.js";

await loadWords();
mountHeader("/sign-in");
byId("form").addEventListener("submit", async (event) => {
  event.preventDefault(); // the token goes into no address
  setText(byId("problem"), "");
  try {
    await post("/session", { token: byId("token").value.trim() });
    location.assign(nextAddress());
  } catch (error) {
    setText(byId("problem"), error.status === 401 ? word("sign-in.wrong") : error.message);
  }
});
byId("token").focus();

/** Return the page to go on to: one of this host alone, whatever the address says. */
function nextAddress() {
  const next = new URL(new URLSearchParams(location.search).get("next") ?? "/", location.origin);
  return next.origin === location.origin ? next.pathname + next.search : "/";
}
