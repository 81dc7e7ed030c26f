/** Alarms with what to do, acknowledged and shelved here. */

import { get, post } from "../api.js";
import { askWhenNew } from "../asking.js";
import { byId, html, setText, showNew } from "../dom.js";
import { actionButton, formDialog } from "../forms.js";
import { prioritySymbol } from "../symbols.js";
import { asker, language, leftOut, said, time, word } from "../words.js";

const SHELF_MINUTES = [15, 60, 240, 480, 1440];
const SHELF_AT_FIRST = 60;
let places = new Map();

const see = askWhenNew(async () => render(await get(`/alarms?language=${language()}`)));

/** Show the alarms; their words are asked for when one of them changed. */
export function showAlarms({ alarms, cameras }) {
  places = new Map(cameras.map(({ id, azimuth_deg: azimuth, elevation_deg: elevation }) => [id, { camera: id, azimuth, elevation }]));
  see(alarms);
}

const act = (alarm, action, values) => post(`/alarms/${alarm.id}/${action}`, values).then(see.again);

function render({ items, shelved, suppressed }) {
  const n = items.filter((alarm) => alarm.state !== "acknowledged").length; // also of those that are gone
  setText(byId("alarms-title"), items.length === 0 ? word("operator.no-alarms") : word("operator.alarms", { all: items.length, new: n }));
  byId("alarms").classList.toggle("calls", items.some((alarm) => alarm.state === "unacknowledged"));
  const list = byId("alarm-list");
  const open = list.querySelector("details")?.open ?? false;
  showNew(list, { items, shelved, suppressed }, () => [
    items.map(card),
    shelved.length > 0 && html.details({ open }, html.summary(word("operator.shelved", { n: shelved.length })), shelved.map(shelvedCard)),
    suppressed.length > 0 && html.p({ class: "weak" }, word("operator.suppressed", { n: suppressed.length })),
  ]);
}

const found = ({ findings }) => findings.map(said).join("; ");

const card = (alarm) =>
  html.article({ class: `alarm ${alarm.state}`, "data-id": alarm.id, "data-priority": alarm.priority, "data-check": alarm.check },
    html.p({ class: "priority" }, prioritySymbol(alarm.priority), html.span(word(`operator.priority-${alarm.priority}`), " · ", word(`operator.alarm-${alarm.state}`), " · ", since(alarm))),
    html.h3(headline(alarm)),
    html.p(html.strong(word("operator.what-to-do")), " ", alarm.action),
    alarm.findings.length > 0 && html.p({ class: "detail", title: found(alarm) }, found(alarm)),
    leftOut(alarm.findings).length > 0 && html.details(
      html.summary(word("operator.reported")), leftOut(alarm.findings).map((each) => html.p({ class: "detail" }, html.q({ lang: "en" }, each)))),
    html.div({ class: "actions" },
      alarm.state !== "acknowledged" && actionButton("operator.acknowledge", () => act(alarm, "acknowledge"), { class: "main" }),
      html.button({ type: "button", onclick: () => shelve(alarm) }, word("operator.shelve")),
    ),
  );

/** Return what the alarm means, after the camera that it is about if it is one alone, and its place. */
function headline({ check, cause, findings }) {
  const named = new Set([check.split(":")[1], ...findings.flatMap(({ subjects }) => subjects)].filter((each) => places.has(each)));
  const [camera] = named;
  return named.size === 1 ? `${word("operator.camera-at", places.get(camera))}: ${cause}` : cause;
}

function since({ raised_at: raisedAt, occurrences, acknowledged_by: by }) {
  const facts = [word("operator.raised", { at: time(raisedAt) })];
  if (occurrences > 1) facts.push(word("operator.occurrences", { n: occurrences }));
  if (by !== null) facts.push(word("operator.acknowledged-by", { by: asker(by) }));
  return facts.join(" · ");
}

const shelvedCard = (alarm) =>
  html.article({ class: "alarm shelved", "data-id": alarm.id },
    html.h3(headline(alarm)),
    html.p({ class: "weak" }, word("operator.shelved-until", { at: time(alarm.shelved_until), by: asker(alarm.shelved_by), reason: alarm.shelf_reason })),
    html.div({ class: "actions" }, actionButton("operator.unshelve", () => act(alarm, "unshelve"), { class: "main" })),
  );

function shelve(alarm) {
  const option = (minutes) => html.option({ value: minutes, selected: minutes === SHELF_AT_FIRST }, word("operator.hours-long", { hours: minutes / 60 }));
  const dialog = formDialog(
    "operator.shelve-title",
    "operator.shelve-do",
    ({ minutes, reason }) => act(alarm, "shelve", { minutes: Number(minutes), reason }),
    html.p(headline(alarm)),
    html.label(word("operator.shelve-for"), html.select({ name: "minutes" }, SHELF_MINUTES.map(option))),
    html.label(word("operator.shelve-reason"), html.textarea({ name: "reason", required: true, maxlength: 2000 })),
  );
  dialog.addEventListener("close", () => dialog.remove());
  dialog.showModal();
}
