/** What the service says of itself: the balance of all triggers, queue, delay, disk, verification. */

import { byId, described, showNew } from "../dom.js";
import { number, span, word } from "../words.js";

const CALIBRATION_LETTERS = 12; // enough to tell one from another
/** Key of the label and the text of each fact. */
const FACTS = [
  ["operator.accounting", ({ accounting: a }) =>
    word("operator.balance", { triggers: number(a.triggers), measured: number(a.measured), rejected: number(a.rejected), lost: number(a.lost), open: number(a.in_progress) })],
  ["operator.queue", ({ queue }) => word("operator.queue-value", { waiting: number(queue.waiting), max: number(queue.max) })],
  ["operator.latency", ({ latency }) =>
    (latency === null ? "–" : word("operator.latency-value", { median: number(latency.median_ms), p99: number(latency.p99_ms) }))],
  ["operator.disk", ({ disk_days: days }) => (days === null ? word("operator.disk-unknown") : word("operator.disk-value", { days: number(days) }))],
  ["operator.verification", ({ verification: { verdict, age_h: age } }) =>
    word(`operator.verification-${verdict}`) + (age === null ? "" : ` · ${word("operator.ago", { span: span(age * 3600) })}`)],
  ["operator.calibration", ({ calibration_id: id }) => id.slice(0, CALIBRATION_LETTERS)],
];

/** Show the facts. */
export function showFacts(overview) {
  const facts = FACTS.map(([key, text]) => [word(key), text(overview)]);
  showNew(byId("fact-list"), facts, () => described(facts));
}
