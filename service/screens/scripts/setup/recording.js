/** The wizard of a recording: the pictures of the next stones, and of some before, as files. */

import { BASE, get, post, remove } from "../api.js";
import { poll } from "../asking.js";
import { html, showNew, table, wide } from "../dom.js";
import { actionButton, askFirst, field, makeForm } from "../forms.js";
import { number, span, time, word } from "../words.js";
import { buttons, columns, hands, makeWizard, progress, quoted, seeingNote, verdict } from "./wizard.js";

const STEPS = ["prepare", "record", "done"];
const POLL_S = 1;
const GOALS = "recording-goals";
/** Where this browser keeps what a recording that it began shall reach. */

/** Show the wizard in `place`. */
export function mountRecording(place) {
  const wizard = makeWizard(place, "recording", STEPS);
  let followed = null, live = null;
  const again = poll(place, POLL_S, async () => {
    const [{ items }, health] = await Promise.all([get("/recordings"), get("/health")]);
    const running = items.find(({ state }) => state === "recording");
    const free = health.checks.disk?.observed_value ?? null;
    followed = running?.name ?? followed;
    const ended = items.find(({ name }) => name === followed);
    if (running !== undefined) {
      wizard.enter("record", () => recordStep(running));
      showRunning(running, free);
    } else if (ended !== undefined) wizard.enter("done", () => doneStep(ended));
    else wizard.enter("prepare", () => prepareStep(items, free));
    wizard.showPast(items, () => past(items));
  });

  function prepareStep(items, free) {
    const known = items.filter(({ bundles }) => bundles > 0);
    const bundle = known.length === 0 ? null : known.reduce((sum, { bytes }) => sum + bytes, 0) / known.reduce((sum, { bundles }) => sum + bundles, 0);
    return [
      html.p(word("setup.recording-what")),
      hands("setup.recording-production", "setup.recording-feed"),
      html.p(word("setup.recording-free", { size: size(free) }), bundle !== null && ` ${word("setup.recording-each", { size: size(bundle), n: number(Math.floor(free / bundle)) })}`),
      makeForm(
        "setup.recording-start",
        async ({ name, count, duration, before }) => {
          const goal = { count: count === "" ? null : Number(count), duration_s: duration === "" ? null : 60 * Number(duration) };
          await post("/recordings", { name, ...goal, pre_trigger: Number(before) });
          localStorage.setItem(GOALS, JSON.stringify({ name, before: Number(before), ...goal }));
          await again();
        },
        field("setup.recording-name", { name: "name", required: true, pattern: "[A-Za-z0-9_\\-]{1,64}", value: `rec-${new Date().toISOString().slice(0, 19).replaceAll(":", "-")}` }, "setup.recording-name-hint"),
        html.div({ class: "fields" },
          field("setup.recording-count", { name: "count", type: "number", min: 1, max: 1_000_000, value: 100 }, "setup.recording-count-hint"),
          field("setup.recording-duration", { name: "duration", type: "number", min: 0.1, max: 1440, step: "any" }, "setup.recording-duration-hint"),
          field("setup.recording-before", { name: "before", type: "number", min: 0, max: 1000, value: 0, required: true }, "setup.recording-before-hint"),
        ),
      ),
    ];
  }

  function recordStep({ name }) {
    live = html.div({ class: "live" });
    return [
      seeingNote(),
      html.p(word("setup.recording-running", { name })),
      live,
      buttons(actionButton("setup.recording-stop", () => post(`/recordings/${name}/stop`).then(again), { class: "main" })),
    ];
  }

  function showRunning({ name, bundles, stones, bytes, created_at: since }, free) {
    const goal = JSON.parse(localStorage.getItem(GOALS) ?? "null");
    const elapsed_s = Math.max(0, (Date.now() - Date.parse(since)) / 1000);
    showNew(live, [bundles, bytes, free, Math.round(elapsed_s)], () => [
      goal?.name === name && goal.count !== null && progress(word("setup.recording-of-count", { n: number(stones), count: number(goal.count + goal.before) }), stones, goal.count + goal.before),
      goal?.name === name && goal.duration_s !== null && progress(word("setup.recording-of-duration", { span: span(elapsed_s), duration: span(goal.duration_s) }), elapsed_s, goal.duration_s),
      html.p(word("setup.recording-so-far", { n: number(bundles), size: size(bytes), span: span(elapsed_s), free: size(free) })),
    ]);
  }

  function doneStep({ name, state, bundles, bytes, ended_by: endedBy, reason }) {
    const recordAgain = () => {
      followed = null;
      return again();
    };
    return [
      verdict(state === "complete", word(`setup.recording-end-${state}`, { name })),
      reason !== null && html.p({ class: "problem" }, quoted(reason)),
      endedBy !== null && html.p(word(`setup.recording-ended-${endedBy}`), " ", word("setup.recording-has", { n: number(bundles), size: size(bytes) })),
      buttons(state === "complete" && download(name, "main"), actionButton("setup.recording-again", recordAgain)),
      state === "complete" && html.p({ class: "weak" }, word("setup.recording-next")),
    ];
  }

  function past(items) {
    const heads = columns("recording-name", "begun", "recording-stones", "recording-size", "state", "detail");
    const rows = items.map(({ name, created_at: at, bundles, bytes, state }) => {
      const actions = html.td({ class: "cell-buttons" }, state === "complete" && download(name), state !== "recording" && deletion(name));
      return [name, time(at), number(bundles), size(bytes), word(`setup.recording-state-${state}`), actions];
    });
    return [html.h2(word("setup.recordings")), items.length === 0 ? html.p({ class: "weak" }, word("setup.recording-none")) : wide(word("setup.recordings"), table({}, heads, rows.reverse()))];
  }

  /** Return a button that must be pressed twice: what it deletes is gone. */
  function deletion(name) {
    const label = (key) => ({ "aria-label": `${word(key)} ${name}` });
    const remover = () => actionButton("setup.recording-delete-sure", () => remove(`/recordings/${name}`).then(again), { class: "danger", ...label("setup.recording-delete-sure") });
    return askFirst("setup.recording-delete", remover, label("setup.recording-delete"));
  }
}

const download = (name, kind = "") =>
  html.a({ class: `button ${kind}`, href: `${BASE}/recordings/${name}.tar`, download: `${name}.tar`, "aria-label": `${word("setup.recording-download")} ${name}` }, word("setup.recording-download"));

/** Return a number of bytes in words. */
function size(bytes) {
  if (bytes === null) return "–";
  const [unit, one] = [["GB", 1e9], ["MB", 1e6], ["kB", 1e3]].find(([, each]) => bytes >= each) ?? ["kB", 1e3];
  return `${number(bytes / one, bytes / one < 10 ? 1 : 0)} ${unit}`;
}
