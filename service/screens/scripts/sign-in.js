/** The page that signs this browser in: by the token of a key, or by a code that is confirmed on another one. */

import { Problem, ROOT, post } from "./api.js";
import { poll } from "./asking.js";
import { byId, html, show, svgFromServer } from "./dom.js";
import { onSubmit } from "./forms.js";
import { startPage, titled } from "./header.js";
import { word } from "./words.js";

await startPage();
titled(word("sign-in.title"));
const refused = ({ status, message }) => (status === 401 ? word("sign-in.wrong") : message);
const signIn = async ({ token }) => { // it goes into no address
  await post("/session", { token: token.trim() });
  location.assign(nextAddress());
};
onSubmit(byId("form"), signIn, byId("problem"), refused);
byId("pair").addEventListener("click", pair);
if (location.hash === "#pair") pair();
else {
  const { documentElement: root } = document;
  new MutationObserver(() => byId("token").focus()).observe(root, { attributeFilter: ["data-painted"] });
}

/** Show a code until it is confirmed; one that has run out gives place to another. */
async function pair() {
  byId("pair").hidden = true;
  const place = byId("code");
  let asked;
  try {
    asked = await post("/session/pairing");
  } catch (error) {
    show(place, html.p({ class: "problem", role: "alert" }, error.message));
    byId("pair").hidden = false;
    return;
  }
  const { code, secret, poll_s: seconds, confirm_at: address, qr_svg: qr } = asked;
  const shown = html.div(
    html.p(html.output({ class: "code", "aria-label": word("sign-in.code") }, `${code.slice(0, 3)} ${code.slice(3)}`)),
    qr !== null && html.div({ class: "qr", role: "img", "aria-label": word("sign-in.qr") }, svgFromServer(qr)),
    html.p(word(address === null ? "sign-in.confirm-here" : "sign-in.confirm-at", { address: address?.split("?")[0] })),
    html.p(html.code(`stonefall keys pair ${code} --name ${word("sign-in.name")} --config FILE`)),
  );
  show(place, shown);
  poll(shown, seconds, async () => {
    try {
      if ((await post("/session/pairing/claim", { secret })).is_signed_in) location.assign(nextAddress());
    } catch (error) {
      if (!(error instanceof Problem)) throw error; // no answer now
      shown.remove();
      pair();
    }
  });
}

/** Return the page to go on to: one of this host alone, whatever the address says; whole, as a path may begin with two slashes. */
function nextAddress() {
  const next = new URL(new URLSearchParams(location.search).get("next") ?? ROOT, location.origin);
  return next.origin === location.origin ? next.href : ROOT;
}
