/** The entry of a sieving: a table as it is copied from a spreadsheet, read back beside the instrument before it is stored. */

import { post } from "../api.js";
import { html, show, table, wide } from "../dom.js";
import { actionButton, field, makeForm } from "../forms.js";
import { fileField } from "./files.js";
import { number, quantity, said, sieve, word } from "../words.js";

/** Heads for a table that has none, or whose head does not say what its numbers are. */
const HEADS = { table: null, "retained-g": "Retained g", "retained-percent": "Retained %", "passing-percent": "Passing %" };
const SAID = ["sample_id", "by", "remark"];
const MOST_LOST_PERCENT = 1;

/**
 * Show the form in `place`, and what was read in `reading`; `onLot` is called with the lot that is chosen, and again after
 * a sieving was stored; what it returns at first is returned.
 */
export function showEntry(place, reading, lots, chosen, onLot) {
  const lot = html.select({ name: "lot" }, lots.map(({ lot, product }) => html.option({ value: lot, selected: lot === chosen }, `${lot} (${product})`)));
  const text = html.textarea({ name: "table", rows: 8, required: true, maxlength: 20_000, spellcheck: "false", class: "table" });
  const more = html.details(html.summary(word("laboratory.more")), fileField(text),
    field("laboratory.dry_mass_g", { name: "dry_mass_g", type: "number", min: 0, step: "any", inputmode: "decimal" }),
    SAID.map((name) => field(`laboratory.${name}`, { name, maxlength: 200, autocomplete: "off" })));
  text.addEventListener("drop", () => (more.open = true)); // a workbook has sheets to choose from
  const form = makeForm("laboratory.read", read,
    html.label(word("laboratory.lot"), lot),
    html.label(word("laboratory.table"), text, html.small(word("laboratory.table-hint"))),
    html.label(word("laboratory.head"), html.select({ name: "head" }, Object.keys(HEADS).map((head) => html.option({ value: head }, word(`laboratory.head-${head}`))))),
    more,
  );
  lot.addEventListener("change", () => {
    show(reading, html.p({ class: "note" }, word("laboratory.nothing-read")));
    onLot(lot.value);
  });
  show(place, form);
  return onLot(chosen);

  async function read(values) {
    show(reading);
    const wanted = sievingOf(values);
    const path = `/lots/${encodeURIComponent(values.lot)}/sieving`;
    const found = await post(path, { ...wanted, dry_run: true });
    const reason = found.implausible && field("laboratory.reason", { required: true, maxlength: 2000, autocomplete: "off" });
    const store = actionButton("laboratory.store", async () => {
      const why = reason ? reason.querySelector("input").value.trim() : "";
      await post(path, { ...wanted, ...(why && { reason: why }) });
      show(reading, html.p({ class: "stored", role: "status" }, word("laboratory.stored", { lot: values.lot })));
      text.value = "";
      onLot(values.lot);
    }, { class: "main" });
    show(reading, readBack(found), found.implausible && html.p({ class: "problem" }, found.implausible_findings.map(said).join("; ")), reason, html.div({ class: "actions" }, store));
    reading.scrollIntoView({ block: "nearest" });
  }
}

/** Return the values of the form as REST takes them. */
function sievingOf({ table, head, dry_mass_g: dryMass, ...values }) {
  const mark = table.includes("\t") ? "\t" : ";";
  const said = Object.fromEntries(SAID.map((name) => [name, values[name]]).filter(([, value]) => value !== ""));
  return { table: HEADS[head] === null ? table : `Sieve mm${mark}${HEADS[head]}\n${table}`, ...(dryMass !== "" && { dry_mass_g: Number(dryMass) }), ...said };
}

function readBack({ understood_findings: understood, mass_g: mass, dry_mass_g: dryMass, sieves }) {
  const lost = mass !== null && dryMass !== null && html.p(word("laboratory.lost", { percent: number(100 * (1 - mass / dryMass), 2), most: MOST_LOST_PERCENT }));
  const rows = [...sieves].reverse().map(({ sieve_mm: mm, retained_g: retained, passing_percent: passing, instrument_percent: { value, low, high }, difference }) => [
    sieve(mm), quantity(retained, 1, ""), number(passing, 1),
    value === null ? word("verdict.not_measured") : [number(value, 1), html.span({ class: "weak" }, ` (${number(low, 1)} – ${number(high, 1)})`)],
    number(difference, 1),
  ]);
  return [
    html.p({ class: "understood" }, understood.map(said).join("; ")),
    mass !== null && html.p(word("laboratory.sum", { mass: quantity(mass, 1, "g") })),
    lost,
    wide(word("laboratory.reading"),
      table({}, ["sieve", "retained", "passing", "instrument", "difference"].map((name) => word(`laboratory.${name}`)), rows, [0, 1, 2, 3, 4])),
  ];
}
