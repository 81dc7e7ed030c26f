/** What came of a calibration: its findings in words for the hands, its figures, the residuals before and after. */

import { described, html, rowHead, table, wide } from "../dom.js";
import { language, number, quantity, word, wordOr } from "../words.js";
import { finding } from "./wizard.js";

/** Return the findings, the fatal ones first, each with what to do. */
export function findings(problems) {
  if (problems.length === 0) return html.p(word("setup.calibration-no-findings"));
  const sorted = [...problems].sort((a, b) => b.is_fatal - a.is_fatal);
  return html.ul({ class: "findings" }, sorted.map(({ code, camera, detail, is_fatal: isFatal }) => {
    const grade = word(isFatal ? "setup.finding-fatal" : "setup.finding-warning");
    const more = language() === "en" ? detail : camera && `${word("setup.camera")} ${camera}`; // figures are English text
    return finding(html.strong(grade, ": ", wordOr(`name.${code}`, code)), more, isFatal);
  }));
}

/** Return the figures of a solution that a person judges it by. */
export function solutionFacts(report) {
  const { held_out_px: heldOut, drops_used: used, uncertainty } = report;
  const leftOut = Object.keys(report.drops_left_out ?? {}).length;
  return html.dl({ class: "facts" }, described([
    [word("setup.fact-drops"), leftOut === 0 ? number(used.length) : word("setup.fact-drops-value", { used: used.length, out: leftOut })],
    [word("setup.fact-held-out"), quantity(heldOut, 3, "px")],
    [word("setup.fact-length"), quantity(uncertainty?.length_sd_percent, 3, "%")],
    [word("setup.fact-after"), quantity(Math.max(0, ...Object.values(report.residuals_after_px)), 3, "px")],
  ]));
}

/** Return the residuals of each camera as bars and figures; `after` is null before anything is solved. */
export function residualBars(before, after) {
  const series = [[word("setup.residual-before"), before], ...(after === null ? [] : [[word("setup.residual-after"), after]])];
  const names = [...new Set(series.flatMap(([, px]) => Object.keys(px)))].sort();
  if (names.length === 0) return [];
  const max = 1.05 * Math.max(...series.flatMap(([, px]) => Object.values(px))) || 1;
  const cell = (px = null, n) =>
    html.td({ class: "bar-cell" },
      html.span({ class: `bar series-${n}`, style: `width: ${(100 * px) / max}%` }),
      html.span({ class: "value" }, number(px, px < 1 ? 3 : 1)),
    );
  const heads = [word("setup.camera"), ...series.map(([name]) => `${name}, px`)];
  const rows = names.map((name) => [rowHead(name), ...series.map(([, px], n) => cell(px[name], n))]);
  return [html.h3(word("setup.residuals")), html.p({ class: "weak" }, word("setup.residuals-explained")), wide(word("setup.residuals"), table({ class: "bars" }, heads, rows))];
}
