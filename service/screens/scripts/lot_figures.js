/** A lot's curve, whose steps can be chosen, and its figures, also as they would be had some stones not fallen. */

import { figureCell, html, rowHead, show, svgFromServer, table } from "./dom.js";
import { digitsOf } from "./measures.js";
import { family, number, quantity, sieve, word } from "./words.js";

/**
 * Show a curve in `place`, with a button over each step that calls `choose` with its upper sieve; `text` is the drawing
 * of this server, which says where its sieves are, and `curve` has its figures.
 */
export function showSteps(place, text, { curve }, chosenMm, choose) {
  const drawing = svgFromServer(text);
  const { width, height } = drawing.viewBox.baseVal;
  const frame = drawing.querySelector(".frame").getAttribute("points").split(" ").map((point) => point.split(",").map(Number));
  const [left, top] = frame[0];
  const [, bottom] = frame[2];
  const passing = new Map([[0, 0], ...curve.map(({ sieve_mm: sieveMm, passing_percent: percent }) => [sieveMm, percent.value])]);
  const sieves = drawing.dataset.sieves.split(" ").map((place) => place.split(",").map(Number));
  const buttons = sieves.map(([sieveMm, x], i) => {
    const [belowMm, from] = i === 0 ? [0, left] : sieves[i - 1];
    const ends = [passing.get(belowMm), passing.get(sieveMm)];
    const share = ends.includes(null) ? word("verdict.not_measured") : word("gallery.share", { percent: number(ends[1] - ends[0], 1) });
    const name = word("gallery.step", { below: sieve(belowMm), sieve: sieve(sieveMm), share });
    const shares = { left: from / width, width: (x - from) / width, top: top / height, height: (bottom - top) / height };
    const style = Object.entries(shares).map(([side, share]) => `${side}: ${100 * share}%`).join("; ");
    return html.button({ type: "button", "data-sieve": sieveMm, "aria-pressed": String(sieveMm === chosenMm), "aria-label": name, title: name, style, onclick: () => choose(sieveMm) });
  });
  const focused = document.activeElement?.closest?.("[data-sieve]")?.dataset.sieve;
  show(place, html.div({ class: "curve-with-steps" }, drawing, buttons));
  if (focused) buttons.find(({ dataset }) => dataset.sieve === focused)?.focus();
}

/** Show the percentiles by mass of each measure of shape, with the number of stones that have it. */
export function showDistributions(place, items) {
  const heads = [html.td(), ...items[0].quantiles.map(({ percent }) => word("gallery.percentile", { percent })), word("gallery.measured")];
  const rows = items.map(({ measure, quantiles, n_stones: n }) => {
    return [rowHead(word(`measure.${measure}`)), ...quantiles.map(({ value }) => cell(value, value, "", digitsOf(measure), 0)), number(n)];
  });
  show(place, table({}, heads, rows, [1, 2, 3, 4]), html.p({ class: "note" }, word("gallery.shape-help")));
}

/** Show the figures; `without` are those without the stones that were taken out, null while there are none. */
export function showFigures(place, all, without, sieveMm) {
  const columns = without === null ? [all] : [all, without];
  const heads = [html.td(), word("gallery.all-stones"), ...(without === null ? [] : [word("gallery.without", { n: without.without.length })])];
  const figure = (name, unit, digits, of) => [rowHead(name), ...columns.map((figures, i) => cell(of(figures), of(all), unit, digits, i))];
  const text = (name, of) => [rowHead(name), ...columns.map(of)];
  const rows = [
    figure("D50", "mm", 2, ({ quantiles }) => quantiles.find(({ percent }) => percent === 50).exact_mm),
    ...family("index").map((name) => figure(word(`index.${name}`), "", Number(word(`decimals.${name}`)), ({ indices }) => indices[name])),
    ...(sieveMm === null ? [] : [figure(word("gallery.passing", { sieve: sieve(sieveMm) }), "%", 1, (figures) => passing(figures, sieveMm))]),
    text(word("gallery.measured"), ({ measured }) => number(measured)),
    text(word("gallery.verdict"), ({ verdict }) => word(`verdict.${verdict ?? "none"}`)),
  ];
  show(place, table({}, heads, rows, [1, 2]), without && html.p({ class: "note" }, word("gallery.what-if")));
}

function cell({ value, low, high }, before, unit, digits, i) {
  const isChanged = i > 0 && (value !== before.value || low !== before.low || high !== before.high);
  const interval = low !== null && `${number(low, digits)} – ${number(high, digits)}`;
  return figureCell(value === null ? word("verdict.not_measured") : quantity(value, digits, unit), interval, isChanged);
}

const passing = ({ curve }, sieveMm) => curve.find((step) => step.sieve_mm === sieveMm)?.passing_percent ?? { value: null, low: null, high: null };
