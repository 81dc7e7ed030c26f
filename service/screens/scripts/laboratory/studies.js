/** The correlation studies of a product: drafts with their error on held-out lots, accepted or withdrawn by hand. */

import { post } from "../api.js";
import { html, table, wide } from "../dom.js";
import { actionButton, field, formDialog } from "../forms.js";
import { number, said, time, word } from "../words.js";

/** Return the table of a product's studies, which are at `path`; `onChange` is called after one was accepted or withdrawn. */
export function studiesTable(path, studies, onChange) {
  if (studies.length === 0) return html.p({ class: "note" }, word("laboratory.no-studies"));
  const rows = studies.map((each) => [
    number(each.version), time(each.at), number(each.factor, 4), number(each.n_lots), number(each.raw_rmse, 2), number(each.held_out_rmse, 2),
    [word(`laboratory.state-${each.is_in_use ? "in-use" : each.state}`), each.reason && `: ${each.reason}`],
    actions(path, each, onChange),
  ]);
  const heads = ["number", "entered", "factor", "lots", "raw-rmse", "held-out-rmse", "state", "actions"].map((name) => word(`laboratory.${name}`));
  return wide(word("laboratory.studies"), table({}, heads, rows, [0, 2, 3, 4, 5]));
}

function actions(path, { version, state, obstacle_findings: obstacles }, onChange) {
  if (state === "withdrawn") return null;
  if (state === "accepted") return html.button({ type: "button", onclick: () => withdraw(`${path}/${version}/withdraw`, onChange) }, word("laboratory.withdraw"));
  if (obstacles.length > 0) return html.ul({ class: "obstacles" }, obstacles.map((each) => html.li(said(each))));
  return actionButton("laboratory.accept", async () => {
    await post(`${path}/${version}/accept`);
    await onChange();
  });
}

function withdraw(path, onChange) {
  const dialog = formDialog("laboratory.withdraw", "laboratory.withdraw", async (values) => {
    await post(path, values);
    await onChange();
  }, field("laboratory.withdraw-reason", { name: "reason", required: true, maxlength: 2000, autocomplete: "off" }));
  dialog.addEventListener("close", () => dialog.remove());
  dialog.showModal();
}
