/** D50, flakiness, shape and rate: the figure now, and how it went over the last hours, with the diary's marks. */

import { getText } from "../api.js";
import { latestOnly } from "../asking.js";
import { mountDiary, showChanges } from "./diary.js";
import { byId, html, setText, show, svgFromServer } from "../dom.js";
import { lookIn, whenResized } from "../drawn.js";
import { number, sieve, word } from "../words.js";

/** Which hours are looked at, and how often they are drawn anew: an hour is quick to draw, and its end is watched. */
const REFRESH_MS = { 1: 10_000, 12: 60_000, 24: 60_000 };
const HOURS = Object.keys(REFRESH_MS).map(Number);
const CHANGES_MS = 60_000;
/** Name of the trend, field of `figures`, unit, digits after the point. */
const TILES = [
  ["d50", "d50_mm", "mm", 1], ["passing_lower", null, "%", 1], ["passing_upper", null, "%", 1],
  ["flakiness", "flakiness_percent", "%", 1], ["shape", "shape_percent", "%", 1], ["rate", null, "/min", 0],
];
const latest = latestOnly();
let hours = Number(localStorage.getItem("hours"));
let drawnAt = 0;
let product = localStorage.getItem("product"); // of the open lot, else of the last one that was
let isOfLots = false;
let sieves = {}; // apertures by name of the trend of their passing, mm
let drawn = localStorage.getItem("trend") ?? TILES[0][0]; // one drawing that can be read rather than four that cannot

/** Make the tiles, the choice of hours and the diary. */
export function mountTrends() {
  show(byId("tiles"), TILES.map(([name, , unit]) =>
    html.button({ type: "button", class: "tile", id: `tile-${name}`, onclick: () => draw(name) },
      html.span({ class: "name" }, word(`operator.figure-${name}`)),
      html.span({ class: "value" }, html.b("–"), " ", html.span({ class: "unit" }, unit)),
      html.span({ class: "interval" }),
    )));
  show(byId("hours"), HOURS.map((each) =>
    html.button({ type: "button", "data-hours": each, onclick: () => choose(each) }, word("operator.last-hours", { hours: each }))));
  byId("control-chart").onclick = () => {
    isOfLots = !isOfLots;
    drawTrend();
  };
  whenResized(byId("trend"), drawTrend, true);
  mountDiary(refresh);
  choose(hours);
  setInterval(() => showChanges(hours), CHANGES_MS);
  setInterval(() => performance.now() - drawnAt >= REFRESH_MS[hours] && drawTrend(), REFRESH_MS[HOURS[0]]);
}

/** Show the figures of now. */
export function showTiles({ figures, stones_per_min: rate, lot }) {
  product = lot?.product ?? product;
  localStorage.setItem("product", product ?? "");
  byId("control-chart").hidden = !product;
  const passing = Object.fromEntries((figures?.passing ?? []).map(({ end, ...each }) => [`passing_${end}`, each]));
  sieves = Object.fromEntries(Object.entries(passing).map(([name, { sieve_mm: mm }]) => [name, mm]));
  for (const [name, field, , digits] of TILES) {
    const figure = name === "rate" ? { value: rate } : field === null ? passing[name]?.percent : figures?.[field];
    const tile = byId(`tile-${name}`);
    if (name in sieves) setText(tile.querySelector(".name"), word("operator.figure-passing", { sieve: sieve(sieves[name]) }));
    setText(tile.querySelector("b"), number(figure?.value, digits));
    setText(tile.querySelector(".interval"), interval(figure, digits));
  }
}

function interval(figure, digits) {
  if (figure?.state === "not_measured") return word("operator.not-measured");
  if (figure?.low === null || figure?.low === undefined) return "";
  const range = word("operator.interval", { low: number(figure.low, digits), high: number(figure.high, digits) });
  return figure.state === "insufficient" ? `${range} · ${word("operator.few-stones")}` : range;
}

function choose(chosen) {
  hours = HOURS.includes(chosen) ? chosen : HOURS[0];
  localStorage.setItem("hours", hours);
  for (const button of byId("hours").children) button.setAttribute("aria-pressed", String(Number(button.dataset.hours) === hours));
  refresh();
}

function draw(name) {
  drawn = name;
  localStorage.setItem("trend", drawn);
  drawTrend();
}

function refresh() {
  showChanges(hours);
  drawTrend();
}

async function drawTrend() {
  drawnAt = performance.now();
  if (!TILES.some(([name]) => name === drawn)) [[drawn]] = TILES;
  for (const [name] of TILES) byId(`tile-${name}`).setAttribute("aria-pressed", String(name === drawn));
  byId("control-chart").setAttribute("aria-pressed", String(isOfLots));
  const figure = drawn in sieves ? `passing_${sieves[drawn]}_mm_percent` : TILES.find(([name]) => name === drawn)[1];
  const asked = isOfLots && product && figure
    ? `/products/${encodeURIComponent(product)}/control/${figure}.svg?${lookIn(byId("trend"), true)}`
    : `/trends/${drawn}.svg?hours=${hours}&${lookIn(byId("trend"), true)}${product ? `&product=${encodeURIComponent(product)}` : ""}`;
  byId("trend").dataset.asked = asked;
  const text = await latest(getText(asked)).catch(() => null);
  if (text !== null) show(byId("trend"), svgFromServer(text));
}
