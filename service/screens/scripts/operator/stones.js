/** The last stones, as they come: the newest falls in on the left. */

import { BASE } from "../api.js";
import { byId, html } from "../dom.js";
import { number, time, word } from "../words.js";

const MAX_SHOWN = 12;
const PICTURE_PAUSE_MS = 250;
const isShown = new Set();
const waiting = []; // cards whose picture is not loaded yet, the newest last
let isLoading = false;

/** Show the stones that are new, the rest stays where it is. */
export function showStones({ newest }) {
  const list = byId("newest");
  const isFirst = isShown.size === 0;
  for (const stone of [...newest].sort((a, b) => a.seq - b.seq)) {
    if (isShown.has(stone.seq)) continue;
    isShown.add(stone.seq);
    list.prepend(card(stone, isFirst));
  }
  while (list.children.length > MAX_SHOWN) {
    isShown.delete(Number(list.lastChild.dataset.seq));
    list.lastChild.remove();
  }
}

function card(stone, isFirst) {
  const isMeasured = stone.outcome === "measured";
  const size = isMeasured ? `${number(stone.sieve_size_mm, 1)} mm` : word(`operator.outcome-${stone.outcome}`);
  const kind = isMeasured ? word(`operator.form-${stone.zingg_class}`) : word(`operator.reason-${stone.reason}`);
  const quality = isMeasured && stone.quality !== "good" ? word(`operator.quality-${stone.quality}`) : "";
  const picture = html.div({ class: "picture" });
  const made = html.li({ "data-seq": stone.seq, class: isFirst ? stone.outcome : `${stone.outcome} falling`, title: time(stone.captured_at) },
    picture,
    html.b(size),
    html.span(kind),
    html.span({ class: "quality" }, quality),
  );
  if (stone.has_mesh) {
    waiting.push({ picture, src: `${BASE}/particles/${stone.seq}/preview.png`, alt: `${kind}, ${size}` });
    loadPictures();
  }
  return made;
}

/** Load one picture at a time, the newest first, and none of a card that is gone: twenty pages ask one process. */
async function loadPictures() {
  if (isLoading) return;
  isLoading = true;
  await null; // the card is put on the page first
  while (waiting.length > 0) {
    const { picture, src, alt } = waiting.pop();
    if (!picture.isConnected) continue;
    await new Promise((done) => picture.replaceChildren(html.img({ src, alt, onload: done, onerror: done })));
    await new Promise((done) => setTimeout(done, PICTURE_PAUSE_MS));
  }
  isLoading = false;
}
