/** Stones as small pictures, each the way to its passport. */

import { BASE, ROOT } from "./api.js";
import { html, setText } from "./dom.js";
import { COVERAGE } from "./measures.js";
import { qualityMark } from "./symbols.js";
import { number, time, word } from "./words.js";

/** Return the tile of a stone; `toggle` takes it out of the figures, or puts it back, null where there are none. */
export function tile(stone, toggle) {
  const still = html.span({ class: "still" });
  if (stone.sieve_size_mm !== null) {
    const picture = html.img({ src: `${BASE}/particles/${stone.seq}/preview.png?size_px=240`, alt: "", loading: "lazy", fetchpriority: "low", width: 240, height: 240 });
    picture.addEventListener("error", () => still.replaceChildren(word("gallery.no-picture")));
    still.append(picture);
  } else still.append(stone.reason ? word(`operator.reason-${stone.reason}`) : "");
  return html.li({ class: "tile", "data-id": stone.id },
    html.a({ href: `${ROOT}stones/${stone.id}` }, still, html.span({ class: "text" }, ...lines(stone))),
    toggle && html.button({ type: "button", onclick: toggle }, word("gallery.take-out")),
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
    html.span(html.strong(stone.sieve_size_mm === null ? word(`stone.outcome-${stone.outcome}`) : `${number(stone.sieve_size_mm, 2)} mm`), stone.quality && qualityMark(stone.quality)),
    share === undefined ? null : html.span(word("gallery.share", { percent: number(share, 1) })),
    stone.zingg_class ? html.span(word(`stone.zingg-${stone.zingg_class}`), stone.volume_sd_percent === null ? "" : ` · V ± ${number(COVERAGE * stone.volume_sd_percent, 1)} %`) : null,
    html.span({ class: "weak" }, `${Number(stone.id.split("-")[1])} · ${time(stone.captured_at)}`),
  ];
}
