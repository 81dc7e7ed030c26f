/** The states of NAMUR NE 107 as shape, letter and colour: no meaning is in a colour alone. */

import { svgElement } from "./dom.js";
import { word } from "./words.js";

const SHAPES = {
  good: ["circle", { cx: 12, cy: 12, r: 11 }, ""],
  check_function: ["path", { d: "M1 3h22L12 23z" }, "C"],
  maintenance_required: ["path", { d: "M12 .5 23.5 12 12 23.5.5 12z" }, "M"],
  out_of_specification: ["path", { d: "M12 1 23 21H1z" }, "S"],
  failure: ["path", { d: "M7 1h10l6 6v10l-6 6H7l-6-6V7z" }, "F"],
};
const LETTER_Y = { check_function: 13.5, out_of_specification: 18.5 };

/** Return the symbol of a state, hidden from screen readers: the word stands beside it. */
export function ne107Symbol(ne107) {
  const [tag, attributes, letter] = SHAPES[ne107];
  return svgElement(
    "svg",
    { viewBox: "0 0 24 24", class: "symbol", "data-ne107": ne107, "aria-hidden": "true" },
    svgElement(tag, attributes),
    letter === ""
      ? svgElement("path", { class: "mark", d: "M6.5 12.5l4 4 7-8" })
      : svgElement("text", { x: 12, y: LETTER_Y[ne107] ?? 16.5, "text-anchor": "middle" }, letter),
  );
}

/** Return the word of a state. */
export const ne107Word = (ne107) => word(`ne107.${ne107}`);
