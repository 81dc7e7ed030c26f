/** States, verdicts and priorities as shape, letter and colour: no meaning is in a colour alone. */

import { html, svg } from "./dom.js";
import { word } from "./words.js";

const CHECK = "M6.5 12.5l4 4 7-8";
const SHAPES = {
  good: ["circle", { cx: 12, cy: 12, r: 11 }, ""],
  check_function: ["path", { d: "M1 3h22L12 23z" }, "C"],
  maintenance_required: ["path", { d: "M12 .5 23.5 12 12 23.5.5 12z" }, "M"],
  out_of_specification: ["path", { d: "M12 1 23 21H1z" }, "S"],
  failure: ["path", { d: "M7 1h10l6 6v10l-6 6H7l-6-6V7z" }, "F"],
};
const LETTER_Y = { check_function: 13.5, out_of_specification: 18.5 };

/** Return a symbol, hidden from screen readers: its word stands beside it. */
const symbol = (meaning, ...shapes) => svg.svg({ viewBox: "0 0 24 24", class: "symbol", ...meaning, "aria-hidden": "true" }, shapes);
const mark = (d) => svg.path({ class: "mark", d });

/** Return the symbol of a state. */
export function ne107Symbol(ne107) {
  const [tag, attributes, letter] = SHAPES[ne107];
  const text = () => svg.text({ x: 12, y: LETTER_Y[ne107] ?? 16.5, "text-anchor": "middle" }, letter);
  return symbol({ "data-ne107": ne107 }, svg[tag](attributes), letter === "" ? mark(CHECK) : text());
}

/** Return the word of a state. */
export const ne107Word = (ne107) => word(`ne107.${ne107}`);

const CROSS = "M7 7l10 10M17 7 7 17";
const VERDICTS = { conforms: CHECK, does_not_conform: CROSS, undecided: "M6 12h12", insufficient: "M7 12h.01M12 12h.01M17 12h.01" };

/** Return the symbol of a verdict; an empty ring for none. */
export const verdictSymbol = (verdict) =>
  symbol({ "data-verdict": verdict }, svg.circle({ cx: 12, cy: 12, r: 11 }), verdict in VERDICTS && mark(VERDICTS[verdict]));

const BARS = { low: 1, medium: 2, high: 3, urgent: 4 };

/** Return as many bars as an alarm is urgent. */
export const prioritySymbol = (priority) =>
  symbol({ "data-priority": priority }, Array.from({ length: BARS[priority] }, (_, bar) => svg.rect({ x: 1 + 6 * bar, y: 17 - 5 * bar, width: 4, height: 6 + 5 * bar })));

const SIGNS = { good: "●", reduced: "◐", degraded: "○" };

/** Return how far a result may be from the truth, as sign and word. */
export const qualityMark = (quality) =>
  html.span({ class: `quality ${quality}` }, html.span({ "aria-hidden": "true" }, SIGNS[quality]), ` ${word(`stone.quality-${quality}`)}`);
