/** What came of a calibration: its findings in words for the hands, its figures, the residuals before and after. */

import { element } from "../dom.js";
import { hasWord, number, word } from "../words.js";
import { bars } from "./charts.js";

/** Return the findings, the fatal ones first, each with what to do. */
export function findings(problems) {
  if (problems.length === 0) return element("p", {}, word("setup.calibration-no-findings"));
  const sorted = [...problems].sort((a, b) => b.is_fatal - a.is_fatal);
  return element(
    "ul",
    { class: "findings" },
    ...sorted.map(({ code, detail, is_fatal: isFatal }) =>
      element(
        "li",
        { class: isFatal ? "fatal" : "" },
        element("strong", {}, word(isFatal ? "setup.finding-fatal" : "setup.finding-warning"), ": ", hasWord(`setup.problem-${code}`) ? word(`setup.problem-${code}`) : code),
        element("small", {}, detail),
      )),
  );
}

/** Return the figures of a solution that a person judges it by. */
export function solutionFacts(report) {
  const { held_out_px: heldOut, drops_used: used, uncertainty } = report;
  const leftOut = Object.keys(report.drops_left_out ?? {}).length;
  const facts = [
    ["setup.fact-drops", leftOut === 0 ? number(used.length) : word("setup.fact-drops-value", { used: used.length, out: leftOut })],
    ["setup.fact-held-out", heldOut === null ? "–" : `${number(heldOut, 3)} px`],
    ["setup.fact-length", uncertainty === null ? "–" : `${number(uncertainty.length_sd_percent, 3)} %`],
    ["setup.fact-after", `${number(Math.max(0, ...Object.values(report.residuals_after_px)), 3)} px`],
  ];
  return element("dl", { class: "facts" }, ...facts.map(([key, value]) => element("div", {}, element("dt", {}, word(key)), element("dd", {}, value))));
}

/** Return the residuals of each camera as bars; `after` is null before anything is solved. */
export function residualBars(before, after) {
  const names = [...new Set([...Object.keys(before), ...Object.keys(after ?? {})])].sort();
  if (names.length === 0) return [];
  const rows = names.map((name) => ({ name, values: [before[name] ?? null, ...(after === null ? [] : [after[name] ?? null])] }));
  const series = [word("setup.residual-before"), ...(after === null ? [] : [word("setup.residual-after")])];
  const digits = (px) => (px < 1 ? 3 : 1);
  return [element("h3", {}, word("setup.residuals")), element("p", { class: "weak" }, word("setup.residuals-explained")), bars(rows, series, { digits, unit: "px" })];
}
