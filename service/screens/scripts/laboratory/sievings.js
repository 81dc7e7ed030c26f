/** The sievings of a lot: what was weighed, and those that count no more. */

import { post } from "../api.js";
import { html, table, wide } from "../dom.js";
import { field, formDialog } from "../forms.js";
import { number, quantity, sieve, time, word } from "../words.js";

/** Return the table of a lot's sievings; `onChange` is called after one was declared void. */
export function sievingsTable(lot, sievings, onChange) {
  if (sievings.length === 0) return html.p({ class: "note" }, word("laboratory.no-sievings", { lot }));
  const rows = sievings.map((each) => ({
    class: each.voided_at && "weak",
    cells: [
      number(each.sieving), time(each.at), [each.sample_id, each.by, each.remark].filter((said) => said !== null).join(", ") || "–",
      Object.entries(each.passing_percent).sort(([a], [b]) => b - a).map(([mm, percent]) => `${sieve(Number(mm))}: ${number(percent, 1)}`).join("; "),
      quantity(each.mass_g, 1, "g"),
      each.voided_at === null ? html.button({ type: "button", onclick: () => voidSieving(lot, each.sieving, onChange) }, word("laboratory.void")) : word("laboratory.voided", { reason: each.void_reason }),
    ],
  }));
  const heads = ["number", "entered", "said", "passing-of", "mass", "actions"].map((name) => word(`laboratory.${name}`));
  return wide(word("laboratory.sievings"), table({}, heads, rows, [0, 4]));
}

function voidSieving(lot, sieving, onChange) {
  const dialog = formDialog("laboratory.void", "laboratory.void", async (values) => {
    await post(`/lots/${encodeURIComponent(lot)}/sieving/${sieving}/void`, values);
    await onChange();
  }, field("laboratory.void-reason", { name: "reason", required: true, maxlength: 2000, autocomplete: "off" }));
  dialog.addEventListener("close", () => dialog.remove());
  dialog.showModal();
}
