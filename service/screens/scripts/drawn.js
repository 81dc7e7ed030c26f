/** Drawings of this server: asked for in the size of their place, so that their letters are as high at any width. */

import { language } from "./words.js";

const LABEL_PX = 11; // height of the letters of a drawing, in its own units
const LABEL_REM = 0.72; // how high they are to be
const STEP_PX = 20; // many places of nearly the same size get the same drawing
const LEAST_PX = { width: 240, height: 120 };
const MOST_PX = { width: 2400, height: 1600 };

/** Return the query for a drawing in `place`; with `hasHeight` that is as high as its place. */
export function lookIn(place, hasHeight = false) {
  const rem = parseFloat(getComputedStyle(document.documentElement).fontSize);
  const unit = Math.max(1, (LABEL_REM * rem) / LABEL_PX);
  const room = (side, length) => Math.min(Math.max(STEP_PX * Math.floor(length / unit / STEP_PX), LEAST_PX[side]), MOST_PX[side]);
  const look = { language: language(), width_px: room("width", place.clientWidth || document.body.clientWidth) };
  return String(new URLSearchParams(hasHeight ? { ...look, height_px: room("height", place.clientHeight) } : look));
}

/** Call `draw` when the drawing in `place` would be asked for in another size. */
export function whenResized(place, draw, hasHeight = false) {
  let last = lookIn(place, hasHeight);
  new ResizeObserver(() => {
    const now = lookIn(place, hasHeight);
    if (now === last || place.clientWidth === 0) return;
    last = now;
    draw();
  }).observe(place);
}
