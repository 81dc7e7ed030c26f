/** Stones as small pictures, each the way to its passport. */

import { BASE } from "./api.js";
import { element, setText } from "./dom.js";
import { COVERAGE } from "./measures.js";
import { qualityMark } from "./quality.js";
import { number, time, word } from "./words.js";

/**
 * Return the tile of a stone.
 *
 * @param stone a result, or a stone behind a step of a curve
 * @param {?() => void} toggle takes it out of the figures, or puts it back; null where there are none
 */
export function tile(stone, toggle) {
  const still = element("span", { class: "still" });
  if (stone.sieve_size_mm !== null) {
    const picture = element("img", { src: `${BASE}/particles/${stone.id}/preview.png`, alt: "", loading: "lazy", fetchpriority: "low", width: 480, height: 480 });
    picture.addEventListener("error", () => still.replaceChildren(word("gallery.no-picture")));
    still.append(picture);
  } else still.append(stone.reason ?? "");
  return element(
    "li",
    { class: "tile", "data-id": stone.id },
    element("a", { href: `/stones/${stone.id}` }, still, element("span", { class: "text" }, ...lines(stone))),
    toggle && element("button", { type: "button", onclick: toggle }, word("gallery.take-out")),
  );
}

/** Mark the tiles of stones that are taken out, and only those. */
export function markOut(tiles, ids) {
  for (const each of tiles.children) {
    const isOut = ids.includes(each.dataset.id);
    each.classList.toggle("out", isOut);
    const button = each.querySelector("button");
    if (button !== null) setText(button, word(isOut ? "gallery.put-back" : "gallery.take-out"));
  }
}

function lines(stone) {
  const share = stone.influence_percent;
  return [
    element("span", {}, element("strong", {}, stone.sieve_size_mm === null ? word(`stone.outcome-${stone.outcome}`) : `${number(stone.sieve_size_mm, 2)} mm`), stone.quality && qualityMark(stone.quality)),
    share === undefined ? null : element("span", {}, word("gallery.share", { percent: number(share, 1) })),
    stone.zingg_class ? element("span", {}, word(`stone.zingg-${stone.zingg_class}`), stone.volume_sd_percent === null ? "" : ` · V ± ${number(COVERAGE * stone.volume_sd_percent, 1)} %`) : null,
    element("span", { class: "weak" }, `${Number(stone.id.split("-")[1])} · ${time(stone.captured_at)}`),
  ];
}
