/** Two lots, or one lot as two versions of the algorithm measured it: both curves in one drawing, and what differs. */

import { get, getText } from "./api.js";
import { digits } from "./curve_steps.js";
import { byId, element, setText, show, svgFromServer } from "./dom.js";
import { mountHeader } from "./header.js";
import { hasWord, language, loadWords, number, word } from "./words.js";

const SIDES = ["a", "b"];

await loadWords();
mountHeader("/compare");
document.title = `${word("compare.title")} – stonefall`;

let generation = 0; // of what is asked for; an answer to what was asked before is not shown
const form = byId("choice");
const { items: lots } = await get("/lots").catch(() => ({ items: [] }));
form.addEventListener("submit", (event) => event.preventDefault());
form.addEventListener("change", async ({ target }) => {
  if (SIDES.includes(target.name)) form.elements[`${target.name}_algorithm_version`].value = "";
  history.pushState(null, "", `${location.pathname}?${chosen()}`);
  await render(chosen());
});
window.addEventListener("popstate", () => render(new URLSearchParams(location.search)));
await render(new URLSearchParams(location.search));

function chosen() {
  return new URLSearchParams([...new FormData(form)].filter(([, value]) => value !== ""));
}

async function render(asked) {
  const mine = ++generation;
  setText(byId("problem"), "");
  try {
    for (const side of SIDES) await fillSide(side, asked);
    const query = chosen();
    const isWhole = SIDES.every((side) => query.has(side));
    if (mine === generation) byId("both").hidden = !isWhole;
    if (!isWhole) return;
    const [comparison, svg] = await Promise.all([get(`/comparisons/lots?${query}`), getText(curveAddress(query))]);
    if (mine !== generation) return;
    show(byId("curves"), svgFromServer(svg));
    showTable(comparison);
  } catch (error) {
    if (mine === generation) setText(byId("problem"), error.message);
  }
}

/** Fill the choices of one side: all lots, and the versions that measured stones of the one chosen. */
async function fillSide(side, asked) {
  const lot = asked.get(side) ?? "";
  const names = lots.map((each) => each.lot);
  if (lot && !names.includes(lot)) names.push(lot); // an old one, beyond the page of lots
  fill(form.elements[side], word("compare.choose"), names.map((name) => [name, name]), lot);
  const { items } = lot === "" ? { items: [] } : await get(`/lots/${encodeURIComponent(lot)}/algorithm-versions`);
  const versions = items.map(({ algorithm_version: version, n_stones: n }) => [version, word("compare.version-of", { version, n: number(n) })]);
  const name = `${side}_algorithm_version`;
  fill(form.elements[name], word("compare.newest"), versions, asked.get(name) ?? "");
}

function fill(select, none, options, value) {
  show(select, ...[["", none], ...options].map(([each, text]) => element("option", { value: each }, text)));
  select.value = value;
}

function curveAddress(query) {
  const sides = { algorithm_version: query.get("a_algorithm_version"), beside_lot: query.get("b"), beside_algorithm_version: query.get("b_algorithm_version"), language: language() };
  return `/lots/${encodeURIComponent(query.get("a"))}/curve.svg?${new URLSearchParams(Object.entries(sides).filter(([, value]) => value !== null))}`;
}

function showTable({ a, b, is_paired: isPaired, figures }) {
  const heads = [sideName(a), sideName(b), word("compare.difference")];
  show(
    byId("figures"),
    element(
      "table",
      {},
      element("thead", {}, element("tr", {}, element("td", {}), ...heads.map((head) => element("th", { scope: "col", class: "number" }, head)))),
      element("tbody", {}, ...figures.filter(({ a: first, b: second }) => first.value !== null || second.value !== null).map(row)),
    ),
    element("p", { class: "note" }, word(isPaired ? "compare.paired" : "compare.unpaired")),
  );
}

function sideName({ lot, algorithm_version: version, measured }) {
  return word(version === null ? "compare.side" : "compare.side-version", { lot, version, n: number(measured) });
}

function row({ figure, a, b, difference, low, high, is_significant: isSignificant }) {
  const [unit, places] = figure.endsWith("_percent") ? ["%", 1] : figure.endsWith("_mm") ? ["mm", 2] : ["", 2];
  const sign = difference > 0 ? "+" : "";
  return element(
    "tr",
    { "data-figure": figure },
    element("th", { scope: "row" }, figureName(figure)),
    ...[a, b].map(({ value, low: from, high: to }) => cell(value, from, to, unit, places)),
    cell(difference, low, high, unit, places, sign, isSignificant),
  );
}

function cell(value, low, high, unit, places, sign = "", isSignificant = false) {
  return element(
    "td",
    { class: isSignificant ? "number changed" : "number" },
    value === null ? "–" : `${sign}${number(value, places)} ${unit}`,
    low === null ? null : element("div", { class: "weak interval" }, word("compare.interval", { low: number(low, places), high: number(high, places) })),
    isSignificant ? element("div", {}, word("compare.significant")) : null,
  );
}

function figureName(figure) {
  const [, sieve] = figure.match(/^passing_(.+)_mm_percent$/) ?? [];
  if (sieve) return word("gallery.passing", { sieve: number(Number(sieve), digits(Number(sieve))) });
  const [, quantile] = figure.match(/^d(\d+)_mm$/) ?? [];
  if (quantile && !hasWord(`compare.figure-${figure}`)) return `D${quantile}`;
  return hasWord(`compare.figure-${figure}`) ? word(`compare.figure-${figure}`) : figure;
}
