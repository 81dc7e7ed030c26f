/** The last stones, as they come: the newest falls in on the left. */

import { BASE } from "../api.js";
import { byId, element } from "../dom.js";
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
  const picture = element("div", { class: "picture" });
  const made = element(
    "li",
    { "data-seq": stone.seq, class: isFirst ? stone.outcome : `${stone.outcome} falling`, title: time(stone.captured_at) },
    picture,
    element("b", {}, size),
    element("span", {}, kind),
    element("span", { class: "quality" }, quality),
  );
  if (stone.has_mesh) {
    waiting.push({ picture, address: `${BASE}/particles/${stone.seq}/preview.png`, text: `${kind}, ${size}` });
    loadNext();
  }
  return made;
}

/** Load one picture at a time, the newest first, and none of a card that is gone: twenty pages ask one process. */
function loadNext() {
  if (isLoading) return;
  let next;
  do next = waiting.pop();
  while (next !== undefined && !next.picture.isConnected && next.picture.parentNode === null);
  if (next === undefined) return;
  isLoading = true;
  const done = () => setTimeout(() => {
    isLoading = false;
    loadNext();
  }, PICTURE_PAUSE_MS);
  next.picture.replaceChildren(element("img", { src: next.address, alt: next.text, onload: done, onerror: done }));
}
