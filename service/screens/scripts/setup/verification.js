/** The wizard of a verification: a ball of known diameter is measured like a stone. */

import { get, post } from "../api.js";
import { element, show } from "../dom.js";
import { number, span, time, word } from "../words.js";
import { controlChart, gauge } from "./charts.js";
import { poll } from "./polling.js";
import { actionButton, field, hands, makeForm, makeWizard, progress, seeingNote, showNew } from "./wizard.js";

const STEPS = ["prepare", "drop", "verdict"];
const POLL_S = 1;
const H = 3_600_000;

/** Show the wizard in `place`. */
export function mountVerification(place) {
  const wizard = makeWizard(place, "verification", STEPS);
  const past = element("div", { class: "card" });
  show(wizard.below, past);
  let followed = null, live = null; // the verification that was seen under way, whose verdict is shown then
  const again = poll(POLL_S, async (isCurrent) => {
    const { limits, items } = await get("/verifications");
    const open = items.find(({ state }) => state === "collecting");
    const diameter = (open ?? items[0])?.diameter_mm ?? 15;
    const chart = await get(`/verifications/chart?diameter_mm=${diameter}`);
    if (!isCurrent()) return;
    followed = open?.id ?? followed;
    const ended = items.find(({ id }) => id === followed);
    if (open !== undefined) {
      wizard.enter("drop", () => dropStep(open));
      showBalls(open, limits);
    } else if (ended !== undefined) wizard.enter("verdict", () => verdictStep(ended, limits));
    else wizard.enter("prepare", () => prepareStep(items, limits));
    showPast(items, chart, limits);
  });

  function prepareStep(items, limits) {
    const last = items.find(({ state }) => ["passed", "failed"].includes(state));
    return [
      element("p", {}, word("setup.verification-what")),
      element("p", { class: isOverdue(last, limits) ? "verdict bad" : "weak" }, lastWords(last, limits)),
      hands("setup.verification-need-ball", "setup.verification-stop-feed", "setup.verification-production"),
      makeForm(
        "setup.verification-start",
        ({ diameter, count, by, note }) => post("/verifications", { diameter_mm: Number(diameter), count: Number(count), by: by || null, note: note || null }).then(again),
        element(
          "div",
          { class: "fields" },
          field("setup.ball-diameter", { name: "diameter", type: "number", min: 1, max: 50, step: "any", value: items[0]?.diameter_mm ?? 15, required: true }, "setup.ball-diameter-hint"),
          field("setup.verification-count", { name: "count", type: "number", min: 2, max: 100, value: 5, required: true }),
        ),
        element("div", { class: "fields" }, field("setup.by", { name: "by", maxlength: 200, autocomplete: "name" }), field("setup.note", { name: "note", maxlength: 2000 })),
      ),
    ];
  }

  function dropStep({ id, diameter_mm: diameter, count }) {
    live = element("div", { class: "live", role: "status" });
    return [
      seeingNote(),
      hands("setup.verification-drop-ball", "setup.verification-one-at-a-time"),
      element("p", { class: "weak" }, word("setup.verification-asked", { diameter: number(diameter, 2), count })),
      live,
      element("div", { class: "buttons" }, actionButton("setup.cancel", () => post(`/verifications/${id}/cancel`).then(again))),
    ];
  }

  function showBalls(verification, limits) {
    const n = verification.balls.filter((ball) => ball.equivalent_diameter_mm !== null).length;
    showNew(live, verification, () => [
      progress(word("setup.verification-progress", { n, count: verification.count }), n, verification.count),
      gauges(verification.summary, limits),
      ballTable(verification),
    ]);
  }

  function verdictStep(verification, limits) {
    const { id, state, summary, problems } = verification;
    return [
      element("p", { class: state === "passed" ? "verdict good" : "verdict bad" }, word(`setup.verification-state-${state}`)),
      gauges(summary, limits),
      problems.length > 0 && element("ul", { class: "findings" }, ...problems.map((problem) => element("li", { class: "fatal" }, problem))),
      state === "failed" && hands("setup.verification-failed-hands"),
      ballTable(verification),
      element(
        "div",
        { class: "buttons" },
        actionButton("setup.verification-again", async () => {
          followed = null;
          await again();
        }, { class: "main" }),
        state === "failed" && element("a", { class: "button", href: "#calibration" }, word("setup.wizard-calibration")),
        ["passed", "failed"].includes(state) && voiding(id, again),
      ),
    ];
  }

  function showPast(items, chart, limits) {
    showNew(past, [items, chart], () => [
      element("h2", {}, word("setup.verification-chart", { diameter: number(chart.diameter_mm, 1) })),
      chart.points.length === 0 ? element("p", { class: "weak" }, word("setup.verification-none")) : controlChart(chart, limits.error_mm),
      chart.points.length > 0 && element("p", { class: "weak" }, word("setup.chart-legend")),
      items.length > 0 && pastTable(items),
    ]);
  }
}

/** Return a button that asks why a verdict shall not count, and says so to the daemon. */
function voiding(id, again) {
  const place = element("span", { class: "action" });
  const ask = () =>
    show(place, makeForm("setup.verification-void-do", ({ reason }) => post(`/verifications/${id}/void`, { reason }).then(again), field("setup.verification-void-reason", { name: "reason", required: true, maxlength: 2000 })));
  show(place, element("button", { type: "button", onclick: ask }, word("setup.verification-void")));
  return place;
}

const isOverdue = (last, { every_h: every }) => every > 0 && (last === undefined || Date.now() - Date.parse(last.changed_at) > every * H);

function lastWords(last, limits) {
  const due = limits.every_h > 0 ? word("setup.verification-every", { span: span(3600 * limits.every_h) }) : word("setup.verification-never-due");
  const before = last === undefined ? word("setup.verification-never") : word(`setup.verification-last-${last.state}`, { span: span(Math.max(0, Date.now() - Date.parse(last.changed_at)) / 1000) });
  return `${isOverdue(last, limits) ? `${word("setup.verification-overdue")} ` : ""}${before} ${due}`;
}

function gauges(summary, limits) {
  const figures = [["error", limits.error_mm, false], ["sd", limits.sd_mm, true], ["vertical_minus_horizontal", limits.vertical_minus_horizontal_mm, false]];
  return element(
    "div",
    { class: "gauges" },
    ...figures.map(([name, limit, isOneSided]) => gauge(word(`setup.verification-figure-${name}`), summary === null ? null : summary[`${name}_mm`], limit, { unit: "mm", isOneSided })),
  );
}

function ballTable({ balls, diameter_mm: diameter }) {
  if (balls.length === 0) return element("p", { class: "weak" }, word("setup.no-drops"));
  const row = ({ equivalent_diameter_mm: measured, vertical_minus_horizontal_mm: difference, detail }, n) =>
    element(
      "tr",
      {},
      element("td", { class: "number" }, number(n + 1)),
      element("td", { class: "number" }, measured === null ? "–" : number(measured, 3)),
      element("td", { class: "number" }, measured === null ? "–" : number(measured - diameter, 3)),
      element("td", { class: "number" }, difference === null ? "–" : number(difference, 3)),
      element("td", {}, detail ?? ""),
    );
  return element(
    "table",
    {},
    element("thead", {}, element("tr", {}, ...["ball-number", "ball-measured", "ball-error", "ball-difference", "ball-detail"].map((key, n) => element("th", { scope: "col", class: n < 4 && "number" }, word(`setup.column-${key}`))))),
    element("tbody", {}, ...balls.map(row)),
  );
}

function pastTable(items) {
  const row = ({ id, changed_at: at, by, state, diameter_mm: diameter, summary }) =>
    element(
      "tr",
      {},
      element("td", {}, id),
      element("td", {}, time(at)),
      element("td", {}, by ?? "–"),
      element("td", { class: "number" }, number(diameter, 2)),
      element("td", { class: "number" }, summary === null ? "–" : number(summary.error_mm, 3)),
      element("td", {}, word(`setup.verification-state-${state}`)),
    );
  return element(
    "table",
    {},
    element("thead", {}, element("tr", {}, ...["id", "ended", "by", "ball-diameter", "ball-error", "state"].map((key, n) => element("th", { scope: "col", class: [3, 4].includes(n) && "number" }, word(`setup.column-${key}`))))),
    element("tbody", {}, ...items.slice(0, 20).map(row)),
  );
}
