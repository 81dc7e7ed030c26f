/** The lots: the open one, all others with their verdicts and reports, and the products that they are of. */

import { get } from "./api.js";
import { askWhenNew } from "./asking.js";
import { byId, html, setText, show } from "./dom.js";
import { holdPaint, showOrigin, showProblem, startPage, titled } from "./header.js";
import { follow } from "./live.js";
import { showLots } from "./lots/list.js";
import { showOpenLot, takeScans } from "./lots/open_lot.js";
import { editProduct, productsTable } from "./lots/products.js";
import { word } from "./words.js";

const STATES = ["open", "closing", "closed", "void"];
const PAGE = 50;
const form = byId("filters");

await startPage();
titled(word("lots.title"));
let shown = [], products = [], nAsked = 0;
const option = (value, text) => html.option({ value }, text);
show(byId("state"), option("", word("lots.any")), STATES.map((state) => option(state, word(`lots.state-${state}`))));
form.addEventListener("input", renew);
form.addEventListener("submit", (event) => event.preventDefault());
byId("more").addEventListener("click", () => list(shown.at(-1).opened_at).catch(showProblem));
byId("new-product").addEventListener("click", () => editProduct(null, showProducts));
takeScans(byId("open-lot"));
const filled = showProducts().catch(showProblem);
holdPaint(filled);
await filled;
const renewWhenNew = askWhenNew(renew);
follow({
  onOverview(overview) {
    showOrigin(overview);
    renewWhenNew({ lot: overview.lot?.lot ?? null, measured: overview.accounting.measured, open: overview.accounting.in_progress });
  },
  onSilence: () => {},
});

/** Show lots and the open one as they are now. */
async function renew() {
  setText(byId("problem"), "");
  await list().catch(showProblem);
}

async function list(before = null) {
  const asked = new URLSearchParams([...new FormData(form)].filter(([, value]) => value !== ""));
  asked.set("limit", PAGE);
  if (before !== null) asked.set("before", before);
  const number = ++nAsked;
  const [page, { items: open }, { items: newest }] = await Promise.all([`/lots?${asked}`, "/lots?state=open", "/lots?limit=1"].map(get));
  if (number !== nAsked) return; // something else was asked for meanwhile
  shown = before === null ? page.items : [...shown, ...page.items];
  showLots(byId("list"), shown, renew);
  byId("more").hidden = page.next_before === null;
  showOpenLot(byId("open-lot"), open[0] ?? null, newest[0]?.product, products, renew);
}

async function showProducts() {
  ({ items: products } = await get("/products"));
  show(byId("products"), products.length === 0 ? html.p({ class: "note" }, word("lots.no-products")) : productsTable(products, showProducts));
  const chosen = byId("product").value;
  show(byId("product"), option("", word("lots.any")), products.map(({ product }) => option(product, product)));
  byId("product").value = chosen;
  await renew();
}
