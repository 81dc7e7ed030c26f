/** Repeatability of a sample: s_r and r of each figure, from lots of the same stones or their sievings (ISO 5725-2). */

import { get } from "../api.js";
import { html, show, table, wide } from "../dom.js";
import { makeForm } from "../forms.js";
import { number, sieve, word } from "../words.js";
import { csvLink } from "./files.js";

const OF = ["instrument", "laboratory"];
const CONDITIONS = ["day", "sampler", "equipment"];
const FIGURES = { d50_mm: "D50, mm", flakiness_percent: "FI, %", shape_percent: "SI, %" };
const COLUMNS = ["mean", "n_runs", "repeatability_sd", "repeatability_sd_low", "repeatability_sd_high", "repeatability_limit"];

/** Show the choice of closed lots in `place`, and what was found in `found`. */
export function showRepeatability(place, found, lots) {
  const choice = (name, values) => html.label(word(`laboratory.${name}`), html.select({ name }, values.map((value) => html.option({ value }, word(`laboratory.${name}-${value}`)))));
  const chosen = html.select({ name: "runs", multiple: true, size: Math.min(Math.max(lots.length, 2), 8), required: true },
    lots.map(({ lot, sample_id: sample }) => html.option({ value: lot }, sample === null ? lot : `${lot} (${sample})`)));
  show(place, makeForm("laboratory.compute", async (values) => {
    show(found);
    const asked = new URLSearchParams({ of: values.of, conditions: values.conditions });
    const names = [...chosen.selectedOptions].map(({ value }) => value);
    (names.length === 1 ? [names[0], names[0]] : names).forEach((name) => asked.append("lot", name));
    show(found, tableOf(await get(`/repeatability?${asked}`)));
  }, html.label(word("laboratory.lots-of-sample"), chosen), choice("of", OF), choice("conditions", CONDITIONS)));
}

function tableOf({ runs, figures }) {
  const sieves = Object.keys(figures).filter((name) => name.startsWith("passing_")).sort((a, b) => sizeOf(b) - sizeOf(a));
  const names = [...Object.keys(FIGURES).filter((name) => name in figures), ...sieves];
  const title = (name) => FIGURES[name] ?? word("laboratory.passing-at", { sieve: sieve(sizeOf(name)) });
  const heads = ["figure", ...COLUMNS].map((name) => word(`laboratory.${name}`));
  const rows = names.map((name) => [title(name), ...COLUMNS.map((column) => number(figures[name][column], column === "n_runs" ? 0 : 2))]);
  const exact = names.map((name) => [name, ...COLUMNS.map((column) => figures[name][column])]);
  return [
    html.p(word("laboratory.runs", { n: runs.length, groups: new Set(runs.map(({ group }) => group)).size })),
    wide(word("laboratory.repeatability"), table({}, heads, rows, [1, 2, 3, 4, 5, 6])),
    csvLink("laboratory.export", "repeatability.csv", [["figure", ...COLUMNS], ...exact]),
  ];
}

const sizeOf = (name) => Number(name.split("_")[1]);
