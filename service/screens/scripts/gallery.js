/** The gallery: stones by filter, and those behind a step of a lot's curve; the address says what is shown. */

import { BASE, get, getText } from "./api.js";
import { latestOnly } from "./asking.js";
import { byId, html, setText, show, svgFromServer } from "./dom.js";
import { lookIn, whenResized } from "./drawn.js";
import { showProblem, startPage, titled } from "./header.js";
import { showDistributions, showFigures, showSteps } from "./lot_figures.js";
import { COVERAGE } from "./measures.js";
import { markOut, tile } from "./tiles.js";
import { language, number, sieve, word } from "./words.js";

const PAGE = 60;
const FIELDS = "captured_at,sieve_size_mm,quality,volume_sd_percent,zingg_class,reason";
const TIMES = ["since", "until"];
/** What is an unfavourable shape, as the parameter of REST. */
const SHAPES = { flaky: ["is_flaky", true], "not-flaky": ["is_flaky", false], "non-cubical": ["is_non_cubical", true], cubical: ["is_non_cubical", false] };

/** Return whether stones are those of a step of the curve, or the heaviest: other filters than the lot do not hold then. */
const isOfLot = () => asked.has("lot") && (asked.has("sieve") || asked.has("order"));
const lotPath = () => `/lots/${encodeURIComponent(asked.get("lot"))}`;

await startPage();
titled(word("gallery.title"));

let asked = new URLSearchParams(location.search);
let listed = null, cursor = null; // what is listed, and where the next page of it begins
const latestFigures = latestOnly(), latestStones = latestOnly(), latestShape = latestOnly();
const form = byId("filters");
await fillChoices();
form.addEventListener("change", () => go(fromForm()));
form.addEventListener("submit", (event) => event.preventDefault());
form.addEventListener("wheel", ({ target }) => target.type === "number" && target.blur(), { passive: true }); // it scrolls the page
byId("heaviest").addEventListener("click", () => go(withChoice("order", asked.has("order") ? null : "heaviest")));
form.addEventListener("reset", (event) => {
  event.preventDefault();
  go(new URLSearchParams());
});
byId("more").addEventListener("click", showMore);
byId("measure").addEventListener("change", () => showShape().catch(showProblem));
const nearEnd = new IntersectionObserver((entries) => {
  if (entries.some(({ isIntersecting }) => isIntersecting) && !byId("more").disabled) showMore();
}, { rootMargin: "400px" });
whenResized(byId("curve"), () => showLot().catch(showProblem));
window.addEventListener("popstate", () => {
  asked = new URLSearchParams(location.search);
  render();
});
render();

async function fillChoices() {
  const option = (value, text) => html.option({ value }, text);
  const options = (place, values, name) => show(byId(place), option("", word("gallery.any")), values.map((value) => option(value, name(value))));
  options("zingg-class", ["equant", "disc", "rod", "blade"], (value) => word(`stone.zingg-${value}`));
  options("shape", Object.keys(SHAPES), (value) => word(`gallery.shape-${value}`));
  options("quality", ["good", "reduced", "degraded"], (value) => word(`stone.quality-${value}`));
  show(byId("outcome"), ["measured", "rejected", "lost"].map((value) => option(value, word(`stone.outcome-${value}`))));
  const { items } = await get("/lots").catch(() => ({ items: [] }));
  options("lot", items.map(({ lot }) => lot), (lot) => lot);
  const lot = asked.get("lot");
  if (lot && !items.some((each) => each.lot === lot)) byId("lot").append(option(lot, lot)); // an old one, beyond the page of lots
}

/** Return what the form asks for; another lot has another curve, so nothing of the old one is chosen. */
function fromForm() {
  const chosen = new URLSearchParams([...new FormData(form)].filter(([, value]) => value !== "" && value !== "measured"));
  if (chosen.has("sieve_set")) chosen.set("sieve_set", sievesOf(chosen.get("sieve_set")));
  if (!chosen.has("lot")) chosen.delete("sieve_set");
  if (["lot", "sieve_set"].some((name) => chosen.get(name) !== asked.get(name))) return chosen;
  for (const [name, value] of asked) if (["sieve", "order", "without"].includes(name)) chosen.append(name, value);
  if (isOfLot()) for (const [name, value] of asked) if (form.elements[name]?.matches("#conditions *")) chosen.append(name, value);
  return chosen;
}

/** Return sieves as REST takes them: apertures between blanks or semicolons may have decimal commas. */
function sievesOf(text) {
  const pieces = text.trim().split(/[;\s]+/).filter((piece) => piece !== "");
  if (pieces.length < 2) return pieces.join();
  return pieces.map((piece) => piece.replace(/,$/, "").replace(",", ".")).join();
}

function go(next) {
  asked = next;
  history.pushState(null, "", `${location.pathname}${asked.size ? `?${asked}` : ""}`);
  render();
}

/** Return what is asked for with one more choice, or one less. */
function changed(name, value, isOn) {
  const next = new URLSearchParams(asked);
  next.delete(name, value);
  if (isOn) next.append(name, value);
  return next;
}

function render() {
  for (const field of form.elements) if (field.name) field.value = asked.get(field.name) ?? (field.name === "outcome" ? "measured" : "");
  byId("conditions").hidden = isOfLot();
  byId("sieves").hidden = !asked.has("lot");
  byId("heaviest").setAttribute("aria-pressed", String(asked.has("order")));
  setText(byId("problem"), "");
  showLot().catch((error) => {
    byId("lot-figures").hidden = true; // it is not of these sieves
    showProblem(error);
  });
  const list = new URLSearchParams(asked);
  list.delete("without");
  if (listed === String(list)) return markOut(byId("tiles"), asked.getAll("without"));
  listed = String(list);
  byId("more").hidden = true;
  cursor = null;
  byId("tiles").replaceChildren();
  setText(byId("list-heading"), word("gallery.loading"));
  showMore();
}

async function showLot() {
  const lot = asked.get("lot");
  const sieveMm = asked.has("sieve") ? Number(asked.get("sieve")) : null;
  const out = asked.getAll("without");
  const sieves = sieveSet();
  const without = new URLSearchParams([...sieves, ...out.map((id) => ["without", id])]);
  byId("lot-figures").hidden = lot === null;
  const found = await latestFigures(lot && Promise.all([
    get(`${lotPath()}/gradation?${sieves}`),
    out.length === 0 ? null : get(`${lotPath()}/gradation?${without}`),
    getText(`${lotPath()}/curve.svg?${lookIn(byId("curve"))}&${without}`),
  ]));
  if (found === null) return;
  const [all, fewer, drawing] = found;
  setText(byId("curve-heading"), word("gallery.curve", { lot, product: all.product?.title ?? "" }));
  showSteps(byId("curve"), drawing, fewer ?? all, sieveMm, (chosenMm) => go(withChoice("sieve", chosenMm === sieveMm ? null : chosenMm)));
  showFigures(byId("figures"), all, fewer, sieveMm);
  if (out.length > 0) byId("figures").append(takenOut(out));
  show(byId("stone-files"), ["csv", "parquet"].map((ending) =>
    html.a({ class: "button", href: `${BASE}${lotPath()}/stones.${ending}${ending === "csv" ? `?language=${language()}` : ""}`, download: `${lot}-stones.${ending}` }, word(`gallery.stones-${ending}`))));
  await showShape();
}

/** Show the distributions of shape over the chosen lot, one of them as a drawing. */
async function showShape() {
  const without = asked.getAll("without").map((id) => ["without", id]);
  const measure = byId("measure").value || "elongation_ratio";
  const [{ items }, drawing] = await latestShape(Promise.all([
    get(`${lotPath()}/distributions?${new URLSearchParams(without)}`),
    getText(`${lotPath()}/distributions/${measure}.svg?${lookIn(byId("distribution"))}&${new URLSearchParams(without)}`),
  ]));
  show(byId("measure"), items.map((each) => html.option({ value: each.measure, selected: each.measure === measure }, word(`measure.${each.measure}`))));
  show(byId("distribution"), svgFromServer(drawing));
  showDistributions(byId("distributions"), items);
}

/** Return what is asked for with one of two ways to choose among the stones of a lot, or none of them. */
function withChoice(name, value) {
  const next = new URLSearchParams(asked);
  for (const each of ["sieve", "order"]) next.delete(each);
  if (value !== null) next.set(name, value);
  return next;
}

function takenOut(ids) {
  const putBack = (id) => html.button({ type: "button", onclick: () => go(changed("without", id, false)) }, word("gallery.put-back-one", { number: Number(id.split("-")[1]) }));
  return html.div({ class: "actions" }, ids.map(putBack));
}

/** Show the next page; at its end the button for one more, which presses itself when it comes into sight. */
async function showMore() {
  const more = byId("more");
  more.disabled = true;
  try {
    const { items, next, title } = await latestStones(isOfLot() ? stonesOfLot() : stonesOfPage());
    cursor = next;
    byId("tiles").append(...items.map(tileOf));
    markOut(byId("tiles"), asked.getAll("without"));
    setText(byId("list-heading"), title);
    show(byId("step"), isOfLot() && html.button({ type: "button", onclick: () => go(withChoice("sieve", null)) }, word("gallery.all-steps")));
    more.hidden = cursor === null;
    nearEnd.unobserve(more);
    nearEnd.observe(more); // says once more whether the end is still in sight
  } catch (error) {
    showProblem(error);
  }
  more.disabled = false;
}

/** Return the query for the sieves that are asked for in the place of the product's. */
function sieveSet() {
  return new URLSearchParams([...asked].filter(([name]) => name === "sieve_set"));
}

async function stonesOfLot() {
  const query = asked.has("sieve") ? `${sieveSet()}&sieve=${asked.get("sieve")}&limit=1000` : `limit=${PAGE}`;
  const { items, above_mm: aboveMm, up_to_mm: upToMm } = await get(`${lotPath()}/particles?${query}`);
  const n = number(items.length);
  const title = upToMm === null ? word("gallery.heaviest-of", { n }) : word("gallery.stones-of-step", { n, below: sieve(aboveMm), sieve: sieve(upToMm) });
  return { items, next: null, title };
}

async function stonesOfPage() {
  const { items, next_cursor: next } = await get(`/particles?${forRest()}`);
  const n = byId("tiles").childElementCount + items.length;
  const title = n === 0 ? word("gallery.none") : word(next === null ? "gallery.stones" : "gallery.stones-so-far", { n: number(n) });
  return { items, next, title };
}

/** Return the query of REST for what is asked for. */
function forRest() {
  const query = new URLSearchParams({ kind: "particle", outcome: "measured", limit: PAGE, fields: FIELDS });
  for (const [name, value] of asked) {
    if (["without", "language", "sieve_set"].includes(name)) continue;
    if (name === "shape") query.set(...SHAPES[value]);
    else if (name === "max_volume_percent") query.set("max_volume_sd_percent", value / COVERAGE);
    else query.set(name, TIMES.includes(name) ? new Date(value).toISOString() : value);
  }
  if (cursor !== null) query.set("cursor", cursor);
  return query;
}

function tileOf(stone) {
  const toggle = () => go(changed("without", stone.id, !asked.getAll("without").includes(stone.id)));
  return tile(stone, asked.has("lot") && stone.sieve_size_mm !== null ? toggle : null);
}
