/** Sievings of months in one table: what is taken and what is refused is shown, row by row, before any of it is stored. */

import { post } from "../api.js";
import { html, show, table } from "../dom.js";
import { actionButton, field, makeForm } from "../forms.js";
import { number, sieve, word } from "../words.js";
import { csvLink, fileField } from "./files.js";

/** One line a lot, or a line a sieve: both are read. */
const TEMPLATE = [["Lot", "Date", "Sample", "Passing % 31.5 mm", "Passing % 16 mm", "Passing % 8 mm", "Passing % 4 mm"], ["L-1207", "2026-03-02", "S-12", 100, 91.5, 12.4, 1.8]];

/** Show the form in `place`, and what was read in `found`; `onStored` is called after sievings were stored. */
export function showHistory(place, found, onStored) {
  const text = html.textarea({ name: "table", rows: 6, required: true, maxlength: 500_000, spellcheck: "false", class: "table" });
  show(place, makeForm("laboratory.preview", preview,
    html.label(word("laboratory.history-table"), text),
    fileField(text),
    csvLink("laboratory.template", "sievings.csv", TEMPLATE),
    field("laboratory.history-by", { name: "by", maxlength: 200, autocomplete: "off" }),
    field("laboratory.history-reason", { name: "reason", maxlength: 2000, autocomplete: "off" }),
  ));

  async function preview({ table: given, by, reason }) {
    show(found);
    const wanted = { table: given, skip_refused: true, ...(by && { by }), ...(reason && { reason }) };
    const { items, refused } = await post("/sievings", { ...wanted, dry_run: true });
    const store = actionButton("laboratory.store-all", async () => {
      const stored = await post("/sievings", wanted);
      show(found, html.p({ class: "stored", role: "status" }, word("laboratory.stored-all", { n: stored.items.length })));
      text.value = "";
      onStored();
    }, { class: "main" });
    show(found,
      html.p(word("laboratory.taken", { n: items.length, refused: refused.length })),
      refused.length > 0 && listed("refused", ["line", "lot", "why"], refused.map(({ line, lot, reason: why }) => [number(line), lot ?? "–", why])),
      items.length > 0 && listed("taken-list", ["lot", "passing-of", "understood"], items.map(({ lot, sieves, understood }) =>
        [lot, [...sieves].reverse().map(({ sieve_mm: mm, passing_percent: percent }) => `${sieve(mm)}: ${number(percent, 1)}`).join("; "), understood])),
      items.length > 0 && html.div({ class: "actions" }, store),
    );
  }
}

const listed = (name, heads, rows) =>
  html.div({ class: `wide ${name}`, tabindex: 0, role: "group", "aria-label": word(`laboratory.${name}`) },
    html.h3(word(`laboratory.${name}`)), table({}, heads.map((head) => word(`laboratory.${head}`)), rows));
