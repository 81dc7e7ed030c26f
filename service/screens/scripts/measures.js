/** The numbers of a stone: in the laboratory's words, with unit, uncertainty and standard. */

import { html, table } from "./dom.js";
import { family, number, quantity, word, wordOr } from "./words.js";

/** Expanded uncertainty by standard deviation: k of the GUM, for about 95 %. */
export const COVERAGE = 2;
/** A dimension lies between two surfaces, whose errors are taken for independent; as in `service/lots/stones.py`. */
const SURFACES = Math.SQRT2;

const ofSurfaces = (stone) => stone.surface_sd_mm && COVERAGE * SURFACES * stone.surface_sd_mm;
const ofVolume = (name, share = 1) => (stone) => stone.volume_sd_percent && stone[name] && (COVERAGE * share * stone.volume_sd_percent * stone[name]) / 100;

/** Unit, digits, uncertainty of what is no plain ratio; `isByHand`: the laboratory measures it, too. */
const DETAILS = {
  length_mm: { unit: "mm", digits: 2, uncertainty: ofSurfaces, isByHand: true },
  width_mm: { unit: "mm", digits: 2, uncertainty: ofSurfaces, isByHand: true },
  thickness_mm: { unit: "mm", digits: 2, uncertainty: ofSurfaces, isByHand: true },
  mass_g: { unit: "g", digits: 3, uncertainty: ofVolume("mass_g"), isByHand: true },
  sieve_size_mm: { unit: "mm", digits: 2, uncertainty: ofSurfaces },
  max_feret_mm: { unit: "mm", digits: 2, uncertainty: ofSurfaces },
  min_feret_mm: { unit: "mm", digits: 2, uncertainty: ofSurfaces },
  volume_mm3: { unit: "mm³", digits: 1, uncertainty: ofVolume("volume_mm3") },
  equivalent_diameter_mm: { unit: "mm", digits: 2, uncertainty: ofVolume("equivalent_diameter_mm", 1 / 3) },
  surface_area_mm2: { unit: "mm²", digits: 0 },
  length_to_thickness: { digits: 2, value: (stone) => stone.max_feret_mm && stone.min_feret_mm && stone.max_feret_mm / stone.min_feret_mm },
  zingg_class: { text: (stone) => stone.zingg_class && word(`stone.zingg-${stone.zingg_class}`) },
  angularity: { digits: 0 },
};

/** Return the digits after the point of a measure. */
export const digitsOf = (name) => DETAILS[name]?.digits ?? 3;

/** Return the table of a stone's numbers; `schema`, of `Result` in the interface's description, explains them. */
export function measuresTable(stone, schema = {}) {
  const heads = ["measure", "value", "uncertainty", "standard"].map((key) => word(`passport.column-${key}`));
  const byHand = html.th({ scope: "col", class: "only-print" }, word("passport.column-by-hand"));
  return table({ class: "measures" }, [...heads, byHand], family("measure").map((name) => row(name, stone, schema)), [1, 2]);
}

function row(name, stone, schema) {
  const { unit = "", digits = digitsOf(name), uncertainty, isByHand = false, value = (stone) => stone[name], text } = DETAILS[name] ?? {};
  const expanded = uncertainty?.(stone);
  const cells = [
    html.th({ scope: "row", title: schema.properties?.[name]?.description }, word(`measure.${name}`)),
    text ? (text(stone) ?? "–") : quantity(value(stone), digits, unit),
    expanded ? `± ${number(expanded, digits)}` : "",
    html.td({ class: "standard" }, wordOr(`passport.standard-${name}`, "")),
    html.td({ class: isByHand ? "only-print box" : "only-print" }),
  ];
  return { cells, "data-measure": name };
}
