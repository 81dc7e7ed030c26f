/** A gradation curve whose steps can be chosen, by pointer and by keys. */

import { element, show, svgFromServer } from "./dom.js";
import { number, word } from "./words.js";

/**
 * Show the curve in `place`, with a button over each step.
 *
 * @param {HTMLElement} place
 * @param {string} svg the drawing of this server, which says where its sieves are
 * @param {{curve: object[]}} figures those of the same curve
 * @param {?number} chosenMm upper sieve of the step that is chosen
 * @param {(sieveMm: number) => void} choose
 */
export function showSteps(place, svg, { curve }, chosenMm, choose) {
  const drawing = svgFromServer(svg);
  const { width, height } = drawing.viewBox.baseVal;
  const frame = drawing.querySelector(".frame").getAttribute("points").split(" ").map((point) => point.split(",").map(Number));
  const [left, top] = frame[0];
  const [, bottom] = frame[2];
  const passing = new Map(curve.map(({ sieve_mm: sieveMm, passing_percent: percent }) => [sieveMm, percent.value]));
  const sieves = drawing.dataset.sieves.split(" ").map((place) => place.split(",").map(Number));
  const buttons = sieves.map(([sieveMm, x], i) => {
    const [belowMm, from] = i === 0 ? [0, left] : sieves[i - 1];
    const button = element("button", {
      type: "button",
      "data-sieve": sieveMm,
      "aria-pressed": String(sieveMm === chosenMm),
      "aria-label": label(belowMm, sieveMm, (passing.get(sieveMm) ?? 0) - (passing.get(belowMm) ?? 0)),
      onclick: () => choose(sieveMm),
    });
    Object.assign(button.style, {
      left: `${(100 * from) / width}%`,
      width: `${(100 * (x - from)) / width}%`,
      top: `${(100 * top) / height}%`,
      height: `${(100 * (bottom - top)) / height}%`,
    });
    button.title = button.ariaLabel;
    return button;
  });
  const focused = document.activeElement?.closest?.("[data-sieve]")?.dataset.sieve;
  show(place, element("div", { class: "curve-with-steps" }, drawing, ...buttons));
  if (focused) buttons.find(({ dataset }) => dataset.sieve === focused)?.focus();
}

const label = (belowMm, sieveMm, percent) =>
  word("gallery.step", { below: number(belowMm, digits(belowMm)), sieve: number(sieveMm, digits(sieveMm)), percent: number(percent, 1) });

/** Return as many digits as the size of a sieve needs. */
export const digits = (sizeMm) => (Number.isInteger(sizeMm) ? 0 : Math.min(3, String(sizeMm).split(".")[1].length));
