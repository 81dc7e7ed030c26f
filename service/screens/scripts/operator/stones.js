/** The last stones, as they come, each the way to its passport: the newest falls in on the left. */

import { BASE, ROOT } from "../api.js";
import { byId, html } from "../dom.js";
import { number, time, word } from "../words.js";

const MAX_SHOWN = 12;
const HOLD_MS = 3000;
const isShown = new Set();
const waiting = []; // cards whose picture is not loaded yet, the newest last
let isLoading = false, heldUntil = 0;

/** Keep the stones where they are for a moment: somebody is about to press one. */
const hold = () => (heldUntil = Date.now() + HOLD_MS);
for (const each of ["pointermove", "pointerdown", "focusin"]) byId("newest").addEventListener(each, hold);

/** Show the stones that are new, the rest stays where it is. */
export function showStones({ newest }) {
  if (Date.now() < heldUntil) return;
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
    html.a({ href: `${ROOT}stones/${stone.id}` },
      picture,
      html.b(size),
      html.span(kind),
      html.span({ class: "quality" }, quality),
    ),
  );
  if (stone.has_mesh) {
    waiting.push({ picture, src: `${BASE}/particles/${stone.seq}/preview.png?size_px=240` });
    loadPictures();
  }
  return made;
}

/** Load one picture at a time, the newest first, and none of a card that is gone: not all came with their stone. */
async function loadPictures() {
  if (isLoading) return;
  isLoading = true;
  await null; // the card is put on the page first
  while (waiting.length > 0) {
    const { picture, src } = waiting.pop();
    if (!picture.isConnected) continue;
    await new Promise((done) => picture.replaceChildren(html.img({ src, alt: "", onload: done, onerror: done })));
  }
  isLoading = false;
}
