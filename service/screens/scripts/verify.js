/** The page that checks a report: the instrument says whether it signed the file, and whether a byte was changed. */

import { get, post } from "./api.js";
import { byId, described, html, setText, show } from "./dom.js";
import { onSubmit } from "./forms.js";
import { startPage, titled } from "./header.js";
import { moment, word } from "./words.js";

const MOST_BYTES = 700_000; // in base64 a request has a third more

await startPage();
titled(word("verify.title"));
get("/instrument/key").then(({ fingerprint }) => setText(byId("key"), word("verify.own-key", { key: fingerprint }))).catch(() => {});
onSubmit(byId("form"), check, byId("problem"));

async function check({ file }) {
  show(byId("found"));
  if (file.size > MOST_BYTES) throw new Error(word("verify.too-large"));
  const { state, statement, fingerprint } = await post("/reports/verify", { pdf: await inBase64(file) });
  const { lot, revision, instrument, signed_at: signedAt } = statement ?? {};
  const { revision: newest } = state === "genuine" ? await get(`/lots/${lot}`).catch(() => ({})) : {};
  const isOld = newest > revision;
  show(byId("found"),
    html.p({ class: state !== "genuine" && "problem", "data-state": state }, html.strong(word(`verify.state-${state}`))),
    isOld && html.p({ class: "problem" }, word("verify.older", { revision: newest })),
    statement && html.dl(described([
      [word("verify.lot"), lot],
      [word("verify.revision"), revision],
      [word("verify.instrument"), instrument ?? "–"],
      [word("verify.signed_at"), moment(signedAt)],
      [word("verify.key"), fingerprint],
    ])));
}

/** Return the bytes of a file as base64. */
const inBase64 = (file) => new Promise((resolve, reject) => {
  const reader = new FileReader();
  reader.onload = () => resolve(reader.result.slice(reader.result.indexOf(",") + 1));
  reader.onerror = () => reject(reader.error);
  reader.readAsDataURL(file);
});
