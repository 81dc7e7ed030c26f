/** The figures of a lot, and what they would be had some stones not fallen. */

import { element, show } from "./dom.js";
import { digits } from "./curve_steps.js";
import { number, word } from "./words.js";

/** Show the figures; `without` are those without the stones that were taken out, null while there are none. */
export function showFigures(place, all, without, sieveMm) {
  const rows = [
    ["D50", "mm", 2, (figures) => figures.quantiles.find(({ percent }) => percent === 50).interpolated_mm],
    [word("gallery.flakiness"), "%", 1, (figures) => figures.indices.flakiness_percent],
    [word("gallery.shape-index"), "%", 1, (figures) => figures.indices.shape_percent],
    ...(sieveMm === null ? [] : [[word("gallery.passing", { sieve: number(sieveMm, digits(sieveMm)) }), "%", 1, (figures) => passing(figures, sieveMm)]]),
  ];
  const columns = without === null ? [all] : [all, without];
  const heads = [word("gallery.all-stones"), without && word("gallery.without", { n: without.without.length })].slice(0, columns.length);
  show(
    place,
    element(
      "table",
      {},
      element("thead", {}, element("tr", {}, element("td", {}), ...heads.map((head) => element("th", { scope: "col", class: "number" }, head)))),
      element(
        "tbody",
        {},
        ...rows.map(([name, unit, places, figure]) => element(
          "tr", {}, element("th", { scope: "row" }, name),
          ...columns.map((figures, i) => cell(figure(figures), figure(all), unit, places, i)))),
        element("tr", {}, element("th", { scope: "row" }, word("gallery.measured")), ...columns.map(({ measured }) => element("td", { class: "number" }, number(measured)))),
        element("tr", {}, element("th", { scope: "row" }, word("gallery.verdict")), ...columns.map(({ verdict }) => element("td", { class: "number" }, verdictWord(verdict)))),
      ),
    ),
    without && element("p", { class: "note" }, word("gallery.what-if")),
  );
}

function cell({ value, low, high }, before, unit, places, i) {
  const isChanged = i > 0 && (value !== before.value || low !== before.low || high !== before.high);
  return element(
    "td",
    { class: isChanged ? "number changed" : "number" },
    value === null ? word("verdict.not_measured") : `${number(value, places)} ${unit}`,
    low === null ? null : element("div", { class: "weak interval" }, `${number(low, places)} – ${number(high, places)}`),
  );
}

function verdictWord(verdict) {
  return verdict === null ? word("verdict.none") : word(`verdict.${verdict}`);
}

const passing = ({ curve }, sieveMm) => curve.find((step) => step.sieve_mm === sieveMm)?.passing_percent ?? { value: null, low: null, high: null };
