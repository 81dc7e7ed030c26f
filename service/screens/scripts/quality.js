/** How far a result may be from the truth, as sign and word: no meaning is in a colour alone. */

import { element } from "./dom.js";
import { word } from "./words.js";

const SIGNS = { good: "●", reduced: "◐", degraded: "○" };

/** Return the quality of a result. */
export const qualityMark = (quality) =>
  element("span", { class: `quality ${quality}` }, element("span", { "aria-hidden": "true" }, SIGNS[quality]), ` ${word(`stone.quality-${quality}`)}`);
