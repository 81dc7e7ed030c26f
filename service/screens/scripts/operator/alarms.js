/** Alarms with what to do, acknowledged and shelved here. */

import { get, post } from "../api.js";
import { byId, element, setText, show } from "../dom.js";
import { prioritySymbol } from "../symbols.js";
import { language, time, word } from "../words.js";

const SHELF_MINUTES = [15, 60, 240, 480, 1440];
let told = null;
let isAsking = false;

/** Show the alarms; their words are asked for when one of them changed. */
export async function showAlarms({ alarms }) {
  const now = JSON.stringify(alarms);
  if (now === told || isAsking) return;
  isAsking = true;
  try {
    render(await get(`/alarms?language=${language()}`));
    told = now;
  } catch {
    // the next overview asks again
  } finally {
    isAsking = false;
  }
}

function render({ items, shelved, suppressed }) {
  const n = items.filter((alarm) => alarm.state === "unacknowledged").length;
  setText(byId("alarms-title"), items.length === 0 ? word("operator.no-alarms") : word("operator.alarms", { all: items.length, new: n }));
  byId("alarms").classList.toggle("calls", n > 0);
  show(
    byId("alarm-list"),
    items.map(card),
    shelved.length > 0 && element("details", {}, element("summary", {}, word("operator.shelved", { n: shelved.length })), ...shelved.map(shelvedCard)),
    suppressed.length > 0 && element("p", { class: "weak" }, word("operator.suppressed", { n: suppressed.length })),
  );
}

function card(alarm) {
  const problem = element("p", { class: "problem", role: "alert" });
  return element(
    "article",
    { class: `alarm ${alarm.state}`, "data-id": alarm.id, "data-priority": alarm.priority, "data-check": alarm.check },
    element("p", { class: "priority" }, prioritySymbol(alarm.priority), word(`operator.priority-${alarm.priority}`), " · ", word(`operator.alarm-${alarm.state}`)),
    element("h3", {}, alarm.cause),
    element("p", { class: "action" }, element("strong", {}, word("operator.what-to-do")), " ", alarm.action),
    element("p", { class: "detail" }, `${alarm.check}: ${alarm.detail ?? ""}`),
    element("p", { class: "weak" }, since(alarm)),
    problem,
    element(
      "div",
      { class: "actions" },
      alarm.state !== "acknowledged" && button("operator.acknowledge", () => post(`/alarms/${alarm.id}/acknowledge`), problem),
      element("button", { type: "button", onclick: () => shelve(alarm) }, word("operator.shelve")),
    ),
  );
}

function since({ raised_at: raisedAt, occurrences, acknowledged_by: by }) {
  const facts = [word("operator.raised", { at: time(raisedAt) })];
  if (occurrences > 1) facts.push(word("operator.occurrences", { n: occurrences }));
  if (by !== null) facts.push(word("operator.acknowledged-by", { by }));
  return facts.join(" · ");
}

function shelvedCard(alarm) {
  const problem = element("p", { class: "problem", role: "alert" });
  return element(
    "article",
    { class: "alarm shelved", "data-id": alarm.id },
    element("h3", {}, alarm.cause),
    element("p", { class: "weak" }, word("operator.shelved-until", { at: time(alarm.shelved_until), by: alarm.shelved_by, reason: alarm.shelf_reason })),
    problem,
    element("div", { class: "actions" }, button("operator.unshelve", () => post(`/alarms/${alarm.id}/unshelve`), problem)),
  );
}

function button(key, act, problem) {
  const made = element("button", { type: "button", class: "main", onclick: run }, word(key));
  async function run() {
    made.disabled = true;
    try {
      await act();
      told = null; // the next overview shows it
    } catch (error) {
      made.disabled = false;
      setText(problem, error.message);
    }
  }
  return made;
}

function shelve(alarm) {
  const minutes = element("select", {}, ...SHELF_MINUTES.map((each) => element("option", { value: each, selected: each === 60 }, word("operator.hours-long", { hours: each / 60 }))));
  const reason = element("textarea", { required: true, maxlength: 2000 });
  const problem = element("p", { class: "problem", role: "alert" });
  const dialog = element(
    "dialog",
    { "aria-labelledby": "shelve-title", onclose: () => dialog.remove() },
    element(
      "form",
      { onsubmit: put },
      element("h2", { id: "shelve-title" }, word("operator.shelve-title")),
      element("p", {}, alarm.cause),
      element("label", {}, word("operator.shelve-for"), minutes),
      element("label", {}, word("operator.shelve-reason"), reason),
      problem,
      element(
        "div",
        { class: "actions" },
        element("button", { type: "button", onclick: () => dialog.close() }, word("operator.cancel")),
        element("button", { class: "main" }, word("operator.shelve-do")),
      ),
    ),
  );
  async function put(event) {
    event.preventDefault();
    try {
      await post(`/alarms/${alarm.id}/shelve`, { minutes: Number(minutes.value), reason: reason.value });
      told = null;
      dialog.close();
    } catch (error) {
      setText(problem, error.message);
    }
  }
  document.body.append(dialog);
  dialog.showModal();
}
