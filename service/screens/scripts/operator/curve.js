/** The gradation curve, as the server draws it for the report. */

import { getText } from "../api.js";
import { askWhenNew } from "../asking.js";
import { byId, setText, show, svgFromServer } from "../dom.js";
import { lookIn, whenResized } from "../drawn.js";
import { word } from "../words.js";

const see = askWhenNew(async ({ lot }) => {
  const of = lot === null ? "/windows/current" : `/lots/${encodeURIComponent(lot)}`;
  show(byId("curve-drawing"), svgFromServer(await getText(`${of}/curve.svg?${lookIn(byId("curve-drawing"), true)}`)));
  setText(byId("curve-title"), lot === null ? word("operator.curve-hour") : word("operator.curve-lot", { lot }));
});

whenResized(byId("curve-drawing"), see.again, true);

/** Show the curve of the open lot, else of the last hour; asked for again when it would be another one. */
export const showCurve = ({ figures }) => figures !== null && see({ lot: figures.lot, version: figures.version });
