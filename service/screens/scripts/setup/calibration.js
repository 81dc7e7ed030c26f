/** The wizard of a calibration: what to drop, what the cameras saw, what came of it. */

import { get, post } from "../api.js";
import { poll } from "../asking.js";
import { html, show, showNew, table, wide } from "../dom.js";
import { actionButton, choices, field, makeForm } from "../forms.js";
import { number, time, word } from "../words.js";
import { findings, residualBars, solutionFacts } from "./calibration_report.js";
import { cameraCoverage, dropList, spaceCoverage, wanted } from "./coverage.js";
import { rigInUse } from "./rig.js";
import { buttons, columns, hands, makeWizard, note, progress, seeingNote, signature, told, verdict } from "./wizard.js";

const STEPS = ["prepare", "drop", "solve", "review", "use"];
const POLL_S = 1;
const OPEN = ["collecting", "solving", "solved"];

/** Show the wizard in `place`; where it is follows from the calibrations that the daemon has. */
export function mountCalibration(place) {
  const wizard = makeWizard(place, "calibration", STEPS);
  let rig = null, live = null, dropsMoreFor = null; // the calibration that a person wants more drops for although it is solved
  const again = poll(place, POLL_S, async () => {
    rig ??= await rigInUse();
    const list = await get("/calibrations");
    const open = list.items.find(({ state }) => OPEN.includes(state));
    const latest = list.items.find(({ origin }) => origin === "session");
    const isWaiting = latest?.state === "accepted" && !list.activations.some(({ id }) => id === latest.id);
    const opened = open && (await get(`/calibrations/${open.id}`));
    if (opened?.state === "solving") wizard.enter("solve", () => solveStep(opened));
    else if (opened?.state === "solved" && dropsMoreFor !== opened.id) wizard.enter("review", () => reviewStep(opened));
    else if (opened !== undefined) {
      wizard.enter("drop", () => dropStep(opened));
      showDrops(opened);
    } else if (isWaiting) wizard.enter("use", () => useStep(latest));
    else wizard.enter("prepare", () => prepareStep(latest));
    showPast(list);
  });

  const act = (id, action) => post(`/calibrations/${id}/${action}`, {}).then(again);

  function prepareStep(latest) {
    return [
      latest?.state === "cancelled" && latest.detail && html.p({ class: "note" }, word("setup.calibration-was-cancelled", { id: latest.id }), " ", told(latest.findings, latest.detail)),
      hands("setup.calibration-need-ball", "setup.calibration-measure-ball", "setup.calibration-stop-feed", "setup.calibration-production"),
      makeForm(
        "setup.calibration-start",
        ({ first, second, method, by, note }) => {
          const diameters = method === "stones" ? [] : [first, second].filter((text) => text !== "").map(Number);
          return post("/calibrations", { ball_diameters_mm: diameters, method, by: by || null, note: note || null }).then(again);
        },
        methodChoice(),
        html.div({ class: "fields balls" },
          field("setup.ball-diameter", { name: "first", type: "number", min: 1, max: 50, step: "any", value: 10, required: true }, "setup.ball-diameter-hint"),
          field("setup.ball-diameter-second", { name: "second", type: "number", min: 1, max: 50, step: "any" }, "setup.ball-diameter-second-hint"),
        ),
        signature(),
      ),
    ];
  }

  function dropStep({ id, ball_diameters_mm: diameters, method }) {
    live = Object.fromEntries(["count", "wanted", "space", "cameras", "drops", "bars", "detail"].map((name) => [name, html.div({ class: `live-${name}` })]));
    live.wanted.role = "status";
    return [
      seeingNote(),
      live.detail,
      hands(...(method === "stones" ? ["setup.calibration-let-stones-fall"] : ["setup.calibration-drop-ball", "setup.calibration-drop-where", "setup.calibration-one-at-a-time"])),
      html.p({ class: "weak" }, word("setup.calibration-production-now", { ball: diameters.map((each) => number(each, 2)).join(", ") || "–" })),
      live.count,
      live.wanted,
      html.div({ class: "columns" }, live.space, live.cameras),
      buttons(
        actionButton("setup.calibration-solve", () => act(id, "solve").then(() => (dropsMoreFor = null)), { class: "main" }),
        actionButton("forms.cancel", () => act(id, "cancel")),
      ),
      html.div({ class: "columns" }, live.drops, live.bars),
    ];
  }

  function showDrops({ detail, findings: why, drops, coverage, residuals_before_px: residuals, ball_diameters_mm: diameters }) {
    const { n_drops: n, goals } = coverage;
    showNew(live.detail, detail, () => detail !== null && note("setup.calibration-not-solved", told(why, detail)));
    showNew(live.count, n, () => progress(word("setup.calibration-count", { n, goal: goals.n_drops }), n, goals.n_drops));
    showNew(live.wanted, coverage, () => wanted(coverage, rig));
    showNew(live.space, [drops, goals], () => spaceCoverage(drops, coverage, rig));
    showNew(live.cameras, drops, () => cameraCoverage(drops, coverage, rig, diameters[0] ?? 10));
    showNew(live.drops, drops, () => dropList(drops));
    showNew(live.bars, residuals, () => residualBars(residuals, null));
  }

  function solveStep({ id, changed_at: since }) {
    const clock = html.span({ role: "timer" });
    poll(clock, 1, async () => show(clock, word("setup.calibration-solving-for", { seconds: number(Math.max(0, (Date.now() - Date.parse(since)) / 1000)) })));
    return [
      html.p(word("setup.calibration-solving")),
      html.div({ class: "progress" }, html.progress({ "aria-label": word("setup.calibration-step-solve") }), clock),
      hands("setup.calibration-solving-hands"),
      buttons(actionButton("forms.cancel", () => act(id, "cancel"))),
    ];
  }

  function reviewStep({ id, report, detail }) {
    const isUsable = detail === null;
    const dropMore = () => {
      dropsMoreFor = id;
      return again();
    };
    return [
      verdict(isUsable, word(isUsable ? "setup.calibration-usable" : "setup.calibration-unusable")),
      findings(report.problems),
      solutionFacts(report),
      residualBars(report.residuals_before_px, report.residuals_after_px),
      buttons(
        isUsable && actionButton("setup.calibration-accept", () => act(id, "accept"), { class: "main" }),
        actionButton("setup.calibration-drop-more", dropMore, { class: isUsable ? "" : "main" }),
        actionButton("setup.calibration-reject", () => act(id, "reject")),
      ),
      html.p({ class: "weak" }, word("setup.calibration-accept-means")),
    ];
  }

  const useStep = ({ id }) => [
    verdict(true, word("setup.calibration-accepted", { id })),
    hands("setup.calibration-activate-means", "setup.calibration-verify-next"),
    buttons(
      actionButton("setup.calibration-activate", () => act(id, "activate"), { class: "main" }),
      html.a({ class: "button", href: "#verification" }, word("setup.wizard-verification")),
    ),
  ];

  function showPast({ active, items }) {
    const activate = (id) => actionButton("setup.calibration-activate", () => act(id, "activate"), { "aria-label": `${word("setup.calibration-activate")} ${id}` });
    const row = ({ id, created_at: at, by, state, detail, findings: why }) => {
      const shown = id === active.id ? "in-use" : state;
      return [id, time(at), by ?? "–", word(`setup.calibration-state-${shown}`), shown === "accepted" ? activate(id) : told(why, detail)];
    };
    wizard.showPast([active, items.map(({ id, state }) => [id, state])], () => [
      html.h2(word("setup.calibration-past")),
      html.p(word("setup.calibration-active", { id: active.id, at: time(active.at), by: active.by ?? "–" })),
      wide(word("setup.calibration-past"), table({}, columns("id", "begun", "by", "state", "detail"), items.map(row))),
    ]);
  }
}

function methodChoice() {
  const showBalls = ({ currentTarget, target }) => currentTarget.form.querySelector(".balls").toggleAttribute("hidden", target.value === "stones");
  return html.fieldset({ onchange: showBalls },
    html.legend(word("setup.calibration-method")),
    choices("method", ["bundle", "stones"], (value) => word(`setup.calibration-method-${value}`)),
  );
}
