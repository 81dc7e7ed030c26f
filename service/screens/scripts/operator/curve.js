/** The gradation curve, as the server draws it for the report. */

import { getText } from "../api.js";
import { byId, setText, show, svgFromServer } from "../dom.js";
import { language, word } from "../words.js";

let shown = null;
let isAsking = false;

/** Show the curve of the open lot, else of the last hour; asked for again when it would be another one. */
export async function showCurve({ figures }) {
  if (figures === null || isAsking || figures.version === shown) return;
  isAsking = true;
  const { lot, version } = figures;
  try {
    const of = lot === null ? "/windows/current" : `/lots/${encodeURIComponent(lot)}`;
    show(byId("curve-drawing"), svgFromServer(await getText(`${of}/curve.svg?language=${language()}`)));
    setText(byId("curve-title"), lot === null ? word("operator.curve-hour") : word("operator.curve-lot", { lot }));
    shown = version;
  } catch {
    // the next overview asks again
  } finally {
    isAsking = false;
  }
}
