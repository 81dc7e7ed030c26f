/** The wizard of a calibration: what to drop, what the cameras saw, what came of it. */

import { get, post } from "../api.js";
import { element, show } from "../dom.js";
import { number, time, word } from "../words.js";
import { findings, residualBars, solutionFacts } from "./calibration_report.js";
import { cameraCoverage, dropList, spaceCoverage, wanted } from "./coverage.js";
import { poll } from "./polling.js";
import { rigInUse } from "./rig.js";
import { actionButton, field, hands, makeForm, makeWizard, progress, seeingNote, showNew } from "./wizard.js";

const STEPS = ["prepare", "drop", "solve", "review", "use"];
const POLL_S = 1;
const OPEN = ["collecting", "solving", "solved"];

/** Show the wizard in `place`; where it is follows from the calibrations that the daemon has. */
export function mountCalibration(place) {
  const wizard = makeWizard(place, "calibration", STEPS);
  let rig = null, dropsMoreFor = null; // the calibration that a person wants more drops for although it is solved
  const past = element("div", { class: "card" });
  show(wizard.below, past);
  const again = poll(POLL_S, async (isCurrent) => {
    rig ??= await rigInUse();
    const list = await get("/calibrations");
    const open = list.items.find(({ state }) => OPEN.includes(state));
    const latest = list.items.find(({ origin }) => origin === "session");
    const isWaiting = latest?.state === "accepted" && !list.activations.some(({ id }) => id === latest.id);
    const opened = open === undefined ? null : await get(`/calibrations/${open.id}`);
    if (!isCurrent()) return;
    if (opened !== null) showOpen(opened);
    else if (isWaiting) wizard.enter("use", () => useStep(latest));
    else wizard.enter("prepare", () => prepareStep(list));
    showPast(list);
  });

  function act(id, action) {
    return post(`/calibrations/${id}/${action}`, {}).then(again);
  }

  function prepareStep(list) {
    const cancelled = list.items.find(({ origin }) => origin === "session");
    return [
      cancelled?.state === "cancelled" && cancelled.detail && element("p", { class: "note" }, word("setup.calibration-was-cancelled", { id: cancelled.id }), ` ${cancelled.detail}`),
      hands("setup.calibration-need-ball", "setup.calibration-measure-ball", "setup.calibration-stop-feed", "setup.calibration-production"),
      makeForm(
        "setup.calibration-start",
        ({ first, second, method, by, note }) => {
          const diameters = method === "stones" ? [] : [first, second].filter((text) => text !== "").map(Number);
          return post("/calibrations", { ball_diameters_mm: diameters, method, by: by || null, note: note || null }).then(again);
        },
        methodChoice(),
        element(
          "div",
          { class: "fields balls" },
          field("setup.ball-diameter", { name: "first", type: "number", min: 1, max: 50, step: "any", value: 10, required: true }, "setup.ball-diameter-hint"),
          field("setup.ball-diameter-second", { name: "second", type: "number", min: 1, max: 50, step: "any" }, "setup.ball-diameter-second-hint"),
        ),
        element("div", { class: "fields" }, field("setup.by", { name: "by", maxlength: 200, autocomplete: "name" }), field("setup.note", { name: "note", maxlength: 2000 })),
      ),
    ];
  }

  function showOpen(calibration) {
    const { id, state } = calibration;
    if (state === "solving") wizard.enter("solve", () => solveStep(calibration));
    else if (state === "solved" && dropsMoreFor !== id) wizard.enter("review", () => reviewStep(calibration));
    else {
      wizard.enter("drop", () => dropStep(calibration));
      showDrops(calibration);
    }
  }

  let live = null;

  function dropStep({ id, ball_diameters_mm: diameters, method }) {
    live = Object.fromEntries(["count", "wanted", "space", "cameras", "drops", "bars", "detail"].map((name) => [name, element("div", { class: `live-${name}` })]));
    live.wanted.setAttribute("role", "status");
    return [
      seeingNote(),
      live.detail,
      hands(...(method === "stones" ? ["setup.calibration-let-stones-fall"] : ["setup.calibration-drop-ball", "setup.calibration-drop-where", "setup.calibration-one-at-a-time"])),
      element("p", { class: "weak" }, word("setup.calibration-production-now", { ball: diameters.map((each) => number(each, 2)).join(", ") || "–" })),
      live.count,
      live.wanted,
      element("div", { class: "columns" }, live.space, live.cameras),
      element(
        "div",
        { class: "buttons" },
        actionButton("setup.calibration-solve", () => act(id, "solve").then(() => (dropsMoreFor = null)), { class: "main" }),
        actionButton("setup.cancel", () => act(id, "cancel")),
      ),
      element("div", { class: "columns" }, live.drops, live.bars),
    ];
  }

  function showDrops({ detail, drops, coverage, residuals_before_px: residuals, ball_diameters_mm: diameters }) {
    showNew(live.detail, detail, () => (detail === null ? [] : [element("p", { class: "note" }, element("strong", {}, word("setup.calibration-not-solved")), ` ${detail}`)]));
    showNew(live.count, coverage.n_drops, () => [progress(word("setup.calibration-count", { n: coverage.n_drops, goal: coverage.goals.n_drops }), coverage.n_drops, coverage.goals.n_drops)]);
    showNew(live.wanted, coverage, () => wanted(coverage, rig));
    showNew(live.space, [drops, coverage.goals], () => spaceCoverage(drops, coverage, rig));
    showNew(live.cameras, drops, () => cameraCoverage(drops, coverage, rig, diameters[0] ?? 10));
    showNew(live.drops, drops, () => dropList(drops));
    showNew(live.bars, residuals, () => residualBars(residuals, null));
  }

  function solveStep({ id, changed_at: since }) {
    const clock = element("span", { role: "timer" });
    poll(1, async () => show(clock, word("setup.calibration-solving-for", { seconds: number(Math.max(0, (Date.now() - Date.parse(since)) / 1000)) })));
    return [
      element("p", {}, word("setup.calibration-solving")),
      element("div", { class: "progress" }, element("progress", { "aria-label": word("setup.calibration-step-solve") }), clock),
      hands("setup.calibration-solving-hands"),
      element("div", { class: "buttons" }, actionButton("setup.cancel", () => act(id, "cancel"))),
    ];
  }

  function reviewStep(calibration) {
    const { id, report, detail } = calibration;
    const isUsable = detail === null;
    return [
      element("p", { class: isUsable ? "verdict good" : "verdict bad" }, word(isUsable ? "setup.calibration-usable" : "setup.calibration-unusable")),
      findings(report.problems),
      solutionFacts(report),
      residualBars(report.residuals_before_px, report.residuals_after_px),
      element(
        "div",
        { class: "buttons" },
        isUsable && actionButton("setup.calibration-accept", () => act(id, "accept"), { class: "main" }),
        actionButton("setup.calibration-drop-more", async () => {
          dropsMoreFor = id;
          await again();
        }, { class: isUsable ? "" : "main" }),
        actionButton("setup.calibration-reject", () => act(id, "reject")),
      ),
      element("p", { class: "weak" }, word("setup.calibration-accept-means")),
    ];
  }

  function useStep({ id }) {
    return [
      element("p", { class: "verdict good" }, word("setup.calibration-accepted", { id })),
      hands("setup.calibration-activate-means", "setup.calibration-verify-next"),
      element(
        "div",
        { class: "buttons" },
        actionButton("setup.calibration-activate", () => act(id, "activate"), { class: "main" }),
        element("a", { class: "button", href: "#verification" }, word("setup.wizard-verification")),
      ),
    ];
  }

  function showPast({ active, items }) {
    showNew(past, [active, items.map(({ id, state }) => [id, state])], () => [
      element("h2", {}, word("setup.calibration-past")),
      element("p", {}, word("setup.calibration-active", { id: active.id, at: time(active.at), by: active.by ?? "–" })),
      element(
        "table",
        {},
        element("thead", {}, element("tr", {}, ...["id", "begun", "by", "state", "detail"].map((key) => element("th", { scope: "col" }, word(`setup.column-${key}`))))),
        element(
          "tbody",
          {},
          ...items.map((each) => {
            const state = each.id === active.id ? "in-use" : each.state;
            return element(
              "tr",
              {},
              element("td", {}, each.id),
              element("td", {}, time(each.created_at)),
              element("td", {}, each.by ?? "–"),
              element("td", {}, word(`setup.calibration-state-${state}`)),
              element(
                "td",
                {},
                each.state === "accepted" && each.id !== active.id ? actionButton("setup.calibration-activate", () => act(each.id, "activate"), { "aria-label": `${word("setup.calibration-activate")} ${each.id}` }) : each.detail ?? "",
              ),
            );
          }),
        ),
      ),
    ]);
  }
}

function methodChoice() {
  const choice = (value, isChecked) =>
    element("label", { class: "choice" }, element("input", { type: "radio", name: "method", value, checked: isChecked }), element("span", {}, word(`setup.calibration-method-${value}`)));
  return element(
    "fieldset",
    { onchange: ({ currentTarget, target }) => currentTarget.form.querySelector(".balls").toggleAttribute("hidden", target.value === "stones") },
    element("legend", {}, word("setup.calibration-method")),
    choice("bundle", true),
    choice("stones", false),
  );
}
