/** The wizard of a verification: a ball of known diameter is measured like a stone. */

import { get, post } from "../api.js";
import { poll } from "../asking.js";
import { html, showNew, table, wide } from "../dom.js";
import { actionButton, askFirst, field, makeForm } from "../forms.js";
import { number, said, span, time, word } from "../words.js";
import { controlChart, gauge } from "./charts.js";
import { buttons, columns, finding, hands, makeWizard, progress, quoted, seeingNote, signature, told, verdict } from "./wizard.js";

const STEPS = ["prepare", "drop", "verdict"];
const POLL_S = 1;
const H = 3_600_000;
const N_PAST = 20;

/** Show the wizard in `place`. */
export function mountVerification(place) {
  const wizard = makeWizard(place, "verification", STEPS);
  let followed = null, live = null; // the verification that was seen under way, whose verdict is shown then
  const again = poll(place, POLL_S, async () => {
    const { limits, items } = await get("/verifications");
    const open = items.find(({ state }) => state === "collecting");
    const diameter = (open ?? items[0])?.diameter_mm ?? 15;
    const chart = await get(`/verifications/chart?diameter_mm=${diameter}`);
    followed = open?.id ?? followed;
    const ended = items.find(({ id }) => id === followed);
    if (open !== undefined) {
      wizard.enter("drop", () => dropStep(open));
      showBalls(open, limits);
    } else if (ended !== undefined) wizard.enter("verdict", () => verdictStep(ended, limits));
    else wizard.enter("prepare", () => prepareStep(items, limits));
    wizard.showPast([items, chart], () => past(items, chart, limits));
  });

  function prepareStep(items, limits) {
    const last = items.find(({ state }) => ["passed", "failed"].includes(state));
    return [
      html.p(word("setup.verification-what")),
      html.p({ class: isOverdue(last, limits) ? "verdict bad" : "weak" }, lastWords(last, limits)),
      hands("setup.verification-need-ball", "setup.verification-stop-feed", "setup.verification-production"),
      makeForm(
        "setup.verification-start",
        ({ diameter, count, by, note }) => post("/verifications", { diameter_mm: Number(diameter), count: Number(count), by: by || null, note: note || null }).then(again),
        html.div({ class: "fields" },
          field("setup.ball-diameter", { name: "diameter", type: "number", min: 1, max: 50, step: "any", value: items[0]?.diameter_mm ?? 15, required: true }, "setup.ball-diameter-hint"),
          field("setup.verification-count", { name: "count", type: "number", min: 2, max: 100, value: 5, required: true }),
        ),
        signature(),
      ),
    ];
  }

  function dropStep({ id, diameter_mm: diameter, count }) {
    live = html.div({ class: "live", role: "status" });
    return [
      seeingNote(),
      hands("setup.verification-drop-ball", "setup.verification-one-at-a-time"),
      html.p({ class: "weak" }, word("setup.verification-asked", { diameter: number(diameter, 2), count })),
      live,
      buttons(actionButton("forms.cancel", () => post(`/verifications/${id}/cancel`).then(again))),
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

  /** Return a form that asks why a verdict shall not count. */
  const voiding = (id) =>
    makeForm("setup.verification-void-do", ({ reason }) => post(`/verifications/${id}/void`, { reason }).then(again),
      field("setup.verification-void-reason", { name: "reason", required: true, maxlength: 2000 }));

  function verdictStep(verification, limits) {
    const { id, state, summary, problems, problem_findings: found } = verification;
    const verifyAgain = () => {
      followed = null;
      return again();
    };
    return [
      verdict(state === "passed", word(`setup.verification-state-${state}`)),
      gauges(summary, limits),
      problems.length > 0 && html.ul({ class: "findings" }, (found.length > 0 ? found.map(said) : problems.map(quoted)).map((each) => finding(each))),
      state === "failed" && hands("setup.verification-failed-hands"),
      ballTable(verification),
      buttons(
        actionButton("setup.verification-again", verifyAgain, { class: "main" }),
        state === "failed" && html.a({ class: "button", href: "#calibration" }, word("setup.wizard-calibration")),
        ["passed", "failed"].includes(state) && askFirst("setup.verification-void", () => voiding(id)),
      ),
    ];
  }
}

const isOverdue = (last, { every_h: every }) => every > 0 && (last === undefined || Date.now() - Date.parse(last.changed_at) > every * H);

function lastWords(last, limits) {
  const due = limits.every_h > 0 ? word("setup.verification-every", { span: span(3600 * limits.every_h) }) : word("setup.verification-never-due");
  const before = last === undefined ? word("setup.verification-never") : word(`setup.verification-last-${last.state}`, { span: span(Math.max(0, Date.now() - Date.parse(last.changed_at)) / 1000) });
  return `${isOverdue(last, limits) ? `${word("setup.verification-overdue")} ` : ""}${before} ${due}`;
}

function gauges(summary, limits) {
  const figures = [["error", limits.error_mm, false], ["sd", limits.sd_mm, true], ["vertical_minus_horizontal", limits.vertical_minus_horizontal_mm, false]];
  return html.div({ class: "gauges" }, figures.map(([name, limit, isOneSided]) =>
    gauge(word(`setup.verification-figure-${name}`), summary === null ? null : summary[`${name}_mm`], limit, isOneSided)));
}

function ballTable({ balls, diameter_mm: diameter }) {
  if (balls.length === 0) return html.p({ class: "weak" }, word("setup.no-drops"));
  const rows = balls.map(({ equivalent_diameter_mm: measured, vertical_minus_horizontal_mm: difference, detail, findings }, n) =>
    [number(n + 1), number(measured, 3), number(measured && measured - diameter, 3), number(difference, 3), told(findings, detail)]);
  return wide(word("setup.wizard-verification"), table({}, columns("ball-number", "ball-measured", "ball-error", "ball-difference", "ball-detail"), rows, [0, 1, 2, 3]));
}

function past(items, chart, limits) {
  const rows = items.slice(0, N_PAST).map(({ id, changed_at: at, by, state, diameter_mm: diameter, summary }) =>
    [id, time(at), by ?? "–", number(diameter, 2), number(summary?.error_mm, 3), word(`setup.verification-state-${state}`)]);
  return [
    html.h2(word("setup.verification-chart", { diameter: number(chart.diameter_mm, 1) })),
    ...(chart.points.length === 0
      ? [html.p({ class: "weak" }, word("setup.verification-none"))]
      : [wide(word("setup.wizard-verification"), controlChart(chart, limits.error_mm)), html.p({ class: "weak" }, word("setup.chart-legend"))]),
    items.length > 0 && wide(word("setup.wizard-verification"), table({}, columns("id", "ended", "by", "ball-diameter", "ball-error", "state"), rows, [3, 4])),
  ];
}
