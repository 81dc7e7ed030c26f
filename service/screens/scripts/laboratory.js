/** The laboratory's page: sievings are read, compared with the instrument, and stored; studies are made and accepted. */

import { get, post } from "./api.js";
import { byId, html, show } from "./dom.js";
import { actionButton } from "./forms.js";
import { holdPaint, showProblem, startPage, titled } from "./header.js";
import { showEntry } from "./laboratory/entry.js";
import { showHistory } from "./laboratory/history.js";
import { showRepeatability } from "./laboratory/repeatability.js";
import { sievingsTable } from "./laboratory/sievings.js";
import { studiesTable } from "./laboratory/studies.js";
import { word } from "./words.js";

await startPage();
titled(word("laboratory.title"));
let lots = [];
holdPaint(showLots().catch(showProblem));

/** Show the form with all lots, and what is known of the chosen one. */
async function showLots() {
  ({ items: lots } = await get("/lots?limit=200"));
  const asked = new URLSearchParams(location.search).get("lot");
  if (asked !== null && !lots.some(({ lot }) => lot === asked)) await get(`/lots/${encodeURIComponent(asked)}`).then((lot) => lots.unshift(lot), showProblem);
  if (lots.length === 0) show(byId("entry"), html.p({ class: "note" }, word("laboratory.no-lots")));
  else {
    showRepeatability(byId("repeatability"), byId("repeatability-found"), lots.filter(({ state }) => state === "closed"));
    showHistory(byId("history"), byId("history-found"), () => showLot(new URLSearchParams(location.search).get("lot")).catch(showProblem));
    await showEntry(byId("entry"), byId("reading"), lots, asked ?? lots[0].lot, (lot) => showLot(lot).catch(showProblem));
  }
}

/** Show the sievings of a lot, and the studies of its product. */
async function showLot(name) {
  const lot = lots.find((each) => each.lot === name);
  const again = () => showLot(name);
  const studies = `/products/${encodeURIComponent(lot.product)}/correlations`;
  history.replaceState(null, "", `?lot=${encodeURIComponent(name)}`);
  const [sievings, known] = await Promise.all([get(`/lots/${encodeURIComponent(name)}/sieving`), get(studies)]);
  show(byId("sievings"), sievingsTable(name, sievings.items, again));
  show(byId("studies"), studiesTable(studies, known.items, again));
  show(byId("study"), actionButton("laboratory.study", async () => {
    await post(studies, {});
    await again();
  }));
}
