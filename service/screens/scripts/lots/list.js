/** The list of lots: what each is, its verdict, its reports, and what can be done with it. */

import { BASE, ROOT, post } from "../api.js";
import { html, rowHead, setText, showNew, table, wide } from "../dom.js";
import { field, formDialog, makeForm, openDialog } from "../forms.js";
import { language, number, time, word } from "../words.js";

const FORMATS = ["pdf", "html", "xlsx", "csv"];

/** Show lots in `place`; where only their stones are more, the rest is left as it is: somebody may be about to press a button. */
export function showLots(place, lots, onChange) {
  const facts = lots.map(({ n_stones: _, ...lot }) => lot);
  showNew(place, facts, () => (lots.length === 0 ? html.p({ class: "note" }, word("lots.none")) : lotsTable(lots, onChange)));
  place.querySelectorAll(".stones").forEach((count, i) => setText(count, number(lots[i].n_stones)));
}

const lotsTable = (lots, onChange) =>
  wide(word("lots.all"), table({},
    ["lot", "product", "opened", "closed", "stones", "verdict", "reports", "actions"].map((column) => word(`lots.${column}`)),
    lots.map((lot) => [
      rowHead(html.a({ href: `${ROOT}gallery?lot=${encodeURIComponent(lot.lot)}` }, lot.lot), said(lot)),
      `${lot.product}, ${word("lots.version", { version: lot.product_version })}`,
      time(lot.opened_at),
      lot.closed_at === null ? word(`lots.state-${lot.state}`) : time(lot.closed_at),
      html.span({ class: "stones" }),
      verdictOf(lot),
      reports(lot),
      lot.state !== "void" && html.div({ class: "buttons" }, [["assign", assign], ["void", voidLot]].map(([name, ask]) =>
        html.button({ type: "button", onclick: () => ask(lot.lot, onChange) }, word(`lots.${name}`, { lot: lot.lot })))),
    ]), [4]));

const said = ({ external_id: id, order, customer }) => {
  const told = [id, order, customer].filter((each) => each !== null);
  return told.length > 0 && html.div({ class: "weak" }, told.join(", "));
};

/** Return the verdict on a lot in words, with what is open yet. */
export function verdictOf({ state, completion, revision, in_progress: n, void_reason: reason }) {
  if (state === "void") return html.span({ class: "problem" }, word("lots.state-void"), `: ${reason}`);
  if (state === "open") return word("lots.state-open");
  if (completion?.revision !== revision) return word("lots.being-completed", { n: number(n) });
  const { verdict, is_partial: isPartial } = completion;
  const text = word(`verdict.${verdict ?? "none"}`);
  return html.span({ class: `verdict ${verdict ?? "none"}` }, verdict !== null && isPartial ? `${text} (${word("lots.as-far-as-measured")})` : text);
}

/** Return links to the reports of a lot; the PDF of a closed one is the issued report, which stays as it is. */
export function reports({ lot, state, completion }) {
  if (state === "void") return null;
  const path = `${BASE}/lots/${encodeURIComponent(lot)}/report`;
  const address = (format) => (format === "pdf" && completion ? ROOT + completion.report.slice(1) : `${path}.${format}?language=${language()}`);
  return html.span({ class: "reports" }, FORMATS.map((format) => html.a({ href: address(format) }, format.toUpperCase())));
}

/** Ask why a lot counts no more. */
function voidLot(lot, onChange) {
  const dialog = formDialog("lots.void", "lots.void", async (values) => {
    await post(`/lots/${encodeURIComponent(lot)}/void`, values);
    await onChange();
  }, html.p(word("lots.void-hint", { lot })), field("lots.reason", { name: "reason", required: true, maxlength: 2000, autocomplete: "off" }));
  dialog.addEventListener("close", () => dialog.remove());
  dialog.showModal();
}

/** Ask for a time, and put the stones of it that are in no lot into this one. */
function assign(lot, onChange) {
  const told = html.p({ role: "status" });
  openDialog({ "aria-label": word("lots.assign-title", { lot }) },
    html.h2(word("lots.assign-title", { lot })),
    html.p(word("lots.assign-hint")),
    makeForm("lots.assign", async ({ since, until }) => {
      const times = { since: new Date(since).toISOString(), until: new Date(until).toISOString() };
      const { n_assigned: n } = await post(`/lots/${encodeURIComponent(lot)}/assign`, times);
      told.textContent = word("lots.assigned", { n: number(n), lot });
      await onChange();
    }, field("lots.since", { name: "since", type: "datetime-local", step: 1, required: true }), field("lots.until", { name: "until", type: "datetime-local", step: 1, required: true })),
    told,
  );
}
