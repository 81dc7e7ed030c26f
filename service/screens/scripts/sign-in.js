/** The page that exchanges the token of a key for a session of this browser. */

import { ROOT, post } from "./api.js";
import { byId } from "./dom.js";
import { onSubmit } from "./forms.js";
import { startPage } from "./header.js";
import { word } from "./words.js";

await startPage();
titled(word("sign-in.title"));
const refused = ({ status, message }) => (status === 401 ? word("sign-in.wrong") : message);
const signIn = async ({ token }) => { // it goes into no address
  await post("/session", { token: token.trim() });
  location.assign(nextAddress());
};
onSubmit(byId("form"), signIn, byId("problem"), refused);
const { documentElement: root } = document;
new MutationObserver(() => byId("token").focus()).observe(root, { attributeFilter: ["data-painted"] });

/** Return the page to go on to: one of this host alone, whatever the address says. */
function nextAddress() {
  const next = new URL(new URLSearchParams(location.search).get("next") ?? ROOT, location.origin);
  return next.origin === location.origin ? next.pathname + next.search : ROOT;
}
