/** Two lots, or one lot as two versions of the algorithm measured it: both curves in one drawing, and what differs. */

import { get, getText } from "./api.js";
import { latestOnly } from "./asking.js";
import { byId, figureCell, html, rowHead, setText, show, svgFromServer, table } from "./dom.js";
import { lookIn, whenResized } from "./drawn.js";
import { holdPaint, showProblem, startPage, titled } from "./header.js";
import { number, sieve, word, wordOr } from "./words.js";

const SIDES = ["a", "b"];
const REFERENCES = ["specification", "history"];
const MOST_OVERLAID = 12;

await startPage();
titled(word("compare.title"));

const latest = latestOnly(), latestOverlay = latestOnly();
const form = byId("choice");
const overlayForm = byId("overlay-choice");
const choiceOf = (of) => new URLSearchParams([...new FormData(of)].filter(([, value]) => value !== ""));
const chosen = () => choiceOf(form);
const listed = get("/lots").catch(() => ({ items: [] }));
for (const each of ["a", "b", "overlaid"]) fill(byId(each), word("compare.loading"), [], "");
holdPaint(listed);
const { items: lots } = await listed;
for (const each of [form, overlayForm]) each.addEventListener("submit", (event) => event.preventDefault());
form.addEventListener("change", ({ target }) => {
  if (SIDES.includes(target.name)) form.elements[`${target.name}_algorithm_version`].value = "";
  keepAddress();
  render(chosen()).catch(showProblem);
});
overlayForm.addEventListener("change", () => {
  keepAddress();
  renderOverlay(choiceOf(overlayForm)).catch(showProblem);
});
const renderAddress = () => {
  const asked = new URLSearchParams(location.search);
  render(asked).catch(showProblem);
  renderOverlay(asked).catch(showProblem);
};
window.addEventListener("popstate", renderAddress);
for (const each of ["curves", "overlay"]) whenResized(byId(each), renderAddress);
renderAddress();

async function render(asked) {
  setText(byId("problem"), "");
  const found = await latest(compared(asked));
  byId("both").hidden = found === null;
  if (found === null) return;
  const [comparison, drawing] = found;
  show(byId("curves"), svgFromServer(drawing));
  showTable(comparison);
}

function keepAddress() {
  history.pushState(null, "", `${location.pathname}?${new URLSearchParams([...chosen(), ...choiceOf(overlayForm)])}`);
}

/** Draw the curves of the chosen lots, with the band that is chosen. */
async function renderOverlay(asked) {
  const wanted = asked.getAll("lot").slice(0, MOST_OVERLAID);
  const names = [...new Set([...lots.map(({ lot }) => lot), ...wanted])];
  show(byId("overlaid"), names.map((name) => html.option({ value: name, selected: wanted.includes(name) }, name)));
  const references = REFERENCES.map((each) => [each, word(`compare.reference-${each}`)]);
  fill(byId("reference"), word("compare.reference-none"), references, asked.get("reference") ?? "");
  const query = new URLSearchParams([...wanted.map((name) => ["lot", name]), ...new URLSearchParams(lookIn(byId("overlay")))]);
  if (asked.get("reference")) query.set("reference", asked.get("reference"));
  const drawing = await latestOverlay(wanted.length > 0 && getText(`/comparisons/curves.svg?${query}`));
  show(byId("overlay"), drawing && svgFromServer(drawing));
}

/** Return the comparison and its drawing, null while a side is not chosen. */
async function compared(asked) {
  for (const side of SIDES) await fillSide(side, asked);
  const query = chosen();
  if (!SIDES.every((side) => query.has(side))) return null;
  return Promise.all([get(`/comparisons/lots?${query}`), getText(curveAddress(query))]);
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
  show(select, [["", none], ...options].map(([each, text]) => html.option({ value: each }, text)));
  select.value = value;
}

function curveAddress(query) {
  const sides = { algorithm_version: query.get("a_algorithm_version"), beside_lot: query.get("b"), beside_algorithm_version: query.get("b_algorithm_version"), ...Object.fromEntries(new URLSearchParams(lookIn(byId("curves")))) };
  return `/lots/${encodeURIComponent(query.get("a"))}/curve.svg?${new URLSearchParams(Object.entries(sides).filter(([, value]) => value !== null))}`;
}

function showTable({ a, b, is_paired: isPaired, figures }) {
  const rows = figures.filter(({ a: first, b: second }) => first.value !== null || second.value !== null).map(row);
  const heads = [html.td(), sideName(a), sideName(b), word("compare.difference")];
  show(byId("figures"), table({}, heads, rows, [1, 2, 3]), html.p({ class: "note" }, word(isPaired ? "compare.paired" : "compare.unpaired")));
}

function sideName({ lot, algorithm_version: version, measured }) {
  return word(version === null ? "compare.side" : "compare.side-version", { lot, version, n: number(measured) });
}

function row({ figure, a, b, difference, low, high, is_significant: isSignificant }) {
  const [unit, places] = figure.endsWith("_percent") ? ["%", 1] : figure.endsWith("_mm") ? ["mm", 2] : ["", 2];
  const sign = difference > 0 ? "+" : "";
  const sides = [a, b].map(({ value, low: from, high: to }) => cell(value, from, to, unit, places));
  return [rowHead(figureName(figure)), ...sides, cell(difference, low, high, unit, places, sign, isSignificant)];
}

function cell(value, low, high, unit, digits, sign = "", isSignificant = false) {
  const interval = low !== null && word("compare.interval", { low: number(low, digits), high: number(high, digits) });
  return figureCell(value === null ? "–" : `${sign}${number(value, digits)} ${unit}`, interval, isSignificant, isSignificant && html.div(word("compare.significant")));
}

function figureName(figure) {
  const [, sieveMm] = figure.match(/^passing_(.+)_mm_percent$/) ?? [];
  if (sieveMm) return word("gallery.passing", { sieve: sieve(Number(sieveMm)) });
  const [, quantile] = figure.match(/^d(\d+)_mm$/) ?? [];
  return wordOr(`compare.figure-${figure}`, quantile ? `D${quantile}` : figure);
}
