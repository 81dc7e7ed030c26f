/** The numbers of a stone: in the laboratory's words, with unit, uncertainty and standard. */

import { html, table } from "./dom.js";
import { number, quantity, word, wordOr } from "./words.js";

/** Expanded uncertainty by standard deviation: k of the GUM, for about 95 %. */
export const COVERAGE = 2;
/** A dimension lies between two surfaces, whose errors are taken for independent; as in `service/lots/stones.py`. */
const SURFACES = Math.SQRT2;

const ofSurfaces = (stone) => stone.surface_sd_mm && COVERAGE * SURFACES * stone.surface_sd_mm;
const ofVolume = (name, share = 1) => (stone) => stone.volume_sd_percent && stone[name] && (COVERAGE * share * stone.volume_sd_percent * stone[name]) / 100;

/** Name, unit, digits, uncertainty; `isByHand`: the laboratory measures it, too. */
const MEASURES = [
  { name: "length_mm", unit: "mm", digits: 2, uncertainty: ofSurfaces, isByHand: true },
  { name: "width_mm", unit: "mm", digits: 2, uncertainty: ofSurfaces, isByHand: true },
  { name: "thickness_mm", unit: "mm", digits: 2, uncertainty: ofSurfaces, isByHand: true },
  { name: "mass_g", unit: "g", digits: 3, uncertainty: ofVolume("mass_g"), isByHand: true },
  { name: "sieve_size_mm", unit: "mm", digits: 2, uncertainty: ofSurfaces },
  { name: "max_feret_mm", unit: "mm", digits: 2, uncertainty: ofSurfaces },
  { name: "min_feret_mm", unit: "mm", digits: 2, uncertainty: ofSurfaces },
  { name: "volume_mm3", unit: "mm³", digits: 1, uncertainty: ofVolume("volume_mm3") },
  { name: "equivalent_diameter_mm", unit: "mm", digits: 2, uncertainty: ofVolume("equivalent_diameter_mm", 1 / 3) },
  { name: "surface_area_mm2", unit: "mm²", digits: 0 },
  { name: "length_to_thickness", digits: 2, value: (stone) => stone.max_feret_mm && stone.min_feret_mm && stone.max_feret_mm / stone.min_feret_mm },
  { name: "elongation_ratio", digits: 3 },
  { name: "flatness_ratio", digits: 3 },
  { name: "zingg_class", text: (stone) => stone.zingg_class && word(`stone.zingg-${stone.zingg_class}`) },
  { name: "sphericity", digits: 3 },
  { name: "convexity", digits: 3 },
  { name: "krumbein", digits: 3 },
  { name: "corey", digits: 3 },
  { name: "angularity", digits: 0 },
];

/** Return the table of a stone's numbers; `schema`, of `Result` in the interface's description, explains them. */
export function measuresTable(stone, schema = {}) {
  const heads = ["measure", "value", "uncertainty", "standard"].map((key) => word(`passport.column-${key}`));
  const byHand = html.th({ scope: "col", class: "only-print" }, word("passport.column-by-hand"));
  return table({ class: "measures" }, [...heads, byHand], MEASURES.map((measure) => row(measure, stone, schema)), [1, 2]);
}

function row({ name, unit = "", digits, uncertainty, isByHand = false, value = (stone) => stone[name], text }, stone, schema) {
  const expanded = uncertainty?.(stone);
  const cells = [
    html.th({ scope: "row", title: schema.properties?.[name]?.description }, word(`passport.measure-${name}`)),
    text ? (text(stone) ?? "–") : quantity(value(stone), digits, unit),
    expanded ? `± ${number(expanded, digits)}` : "",
    html.td({ class: "standard" }, wordOr(`passport.standard-${name}`, "")),
    html.td({ class: isByHand ? "only-print box" : "only-print" }),
  ];
  return { cells, "data-measure": name };
}
