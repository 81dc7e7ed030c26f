/** Whether what falls conforms: in one sentence, figure by figure, and for the lots before. */

import { ROOT, get } from "../api.js";
import { askWhenNew } from "../asking.js";
import { byId, html, setText, showNew } from "../dom.js";
import { verdictSymbol } from "../symbols.js";
import { number, sieve, span, time, word } from "../words.js";

const GRAVEST_FIRST = ["does_not_conform", "insufficient", "undecided", "conforms", "not_measured"];
const DECIDED = ["conforms", "does_not_conform"];
const N_HISTORY = 12;

/** Show whether the open lot conforms, and when it will be known; without one the verdict on the last. */
export function showVerdict({ lot, last_lot: last, figures }) {
  const ofLot = lot !== null && figures?.lot === lot.lot ? figures : null; // those of the last hour are of no lot
  const verdict = (lot === null ? last?.completion?.verdict : ofLot?.verdict) ?? "none";
  byId("verdict").dataset.verdict = verdict;
  const text = lot !== null ? sentence(lot, ofLot) : last === null ? word("operator.no-lot-yet") : closedSentence(last);
  showNew(byId("verdict-word"), [verdict, text], () => [verdictSymbol(verdict), html.span(text)]);
  const partial = ofLot?.is_partial ? word("operator.partial") : "";
  const told = [countdown(ofLot?.decisions ?? []), partial].join(" ").trim();
  setText(byId("countdown"), told);
  byId("countdown").title = told; // a wall has room for its beginning
  const isKnown = lot !== null && DECIDED.includes(verdict);
  showNew(byId("last-lot"), [last, lot === null, isKnown], () => (last === null || isKnown ? [] : lastLot(last, lot === null)));
}

/** Return the verdict on an open lot, as "L-1207 conforms except SI: 213 more stones, 2 min". */
export function sentence({ lot, n_stones: stones }, figures) {
  if (figures === null) return word("operator.sentence-nothing", { lot, stones: number(stones) });
  const { verdict, decisions, measured, is_partial: isPartial } = figures;
  const those = (...verdicts) => decisions.filter(({ decision }) => verdicts.includes(decision.verdict));
  const values = { lot, stones: number(measured), figures: named(those("does_not_conform")) };
  const kind = kindOf(verdict, isPartial);
  if (verdict !== "undecided") return word(`operator.sentence-${kind}`, values);
  const open = those("undecided", "insufficient");
  const stated = { lot, figures: named(open), needs: needs(open) };
  return word(those("conforms").length > 0 ? "operator.sentence-except" : "operator.sentence-undecided", stated);
}

const kindOf = (verdict, isPartial) => (verdict === "conforms" && isPartial ? "conforms-partly" : verdict ?? "none");
const named = (decisions) => decisions.map(nameOf).join(", ");
const nameOf = ({ sieve_mm: mm, index }) => (index === null ? `${sieve(mm)} mm` : word(`index-short.${index}`));

/** Return the stones and the time that the slowest of the open figures still takes. */
function needs(open) {
  const most = (field) => open.reduce((longest, { decision }) => Math.max(longest, decision[field] ?? 0), 0);
  const [stones, seconds] = [most("more_stones"), most("more_s")];
  if (stones === 0) return word("operator.needs-more");
  return seconds === 0 ? word("operator.needs-stones", { stones: number(stones) }) : word("operator.needs-stones-and-time", { stones: number(stones), time: span(seconds) });
}

function closedSentence({ lot, completion }) {
  if (completion === null) return word("operator.sentence-completing", { lot });
  const { verdict, is_partial: isPartial, measured } = completion;
  const kind = kindOf(verdict, isPartial);
  const key = ["does_not_conform", "undecided"].includes(kind) ? `operator.sentence-closed-${kind}` : `operator.sentence-${kind}`;
  return word(key, { lot, stones: number(measured) });
}

/** Return where the issued report is, below the path that a proxy has this page at. */
const issued = ({ report }) => ROOT + report.slice(1);

const lastLot = (last, isSaid) => [
  isSaid ? html.span(word("operator.closed-at", { at: time(last.closed_at) })) : [
    verdictSymbol(last.completion?.verdict ?? "none"),
    html.span(word("operator.last-lot", { sentence: closedSentence(last), at: time(last.closed_at) })),
  ],
  last.completion && html.a({ href: issued(last.completion) }, word("operator.report")),
];

const seeHistory = askWhenNew(async () => {
  const { items } = await get(`/lots?limit=${N_HISTORY + 1}`);
  const closed = items.filter(({ state }) => state === "closed").slice(0, N_HISTORY);
  showNew(byId("history"), closed.map(({ lot, completion }) => [lot, completion]), () => closed.map(past));
});

/** Show the verdicts on the newest lots, the newest first: shape, colour and name, each the way to its report. */
export const showHistory = ({ lot, last_lot: last }) => seeHistory({ lot: lot?.lot ?? null, last });

function past({ lot, completion }) {
  const verdict = completion?.verdict ?? "none";
  const href = completion ? issued(completion) : `${ROOT}gallery?lot=${encodeURIComponent(lot)}`;
  const text = `${lot}: ${word(`verdict.${verdict}`)}`;
  return html.li({ "data-verdict": verdict }, html.a({ href, title: text, "aria-label": text }, verdictSymbol(verdict), html.span(lot)));
}

/** Return what is decided and what is not, as "12.5 mm (11 %, allowed 85 to 99 %): does not conform; 16 mm: conforms". */
function countdown(decisions) {
  return GRAVEST_FIRST.map((verdict) => [verdict, decisions.filter(({ decision }) => decision.verdict === verdict)])
    .filter(([, those]) => those.length > 0)
    .map(([verdict, those]) => `${those.map(judged).join(", ")}: ${word(`verdict.${verdict}`)}`)
    .join("; ");
}

function judged({ sieve_mm, index, percent, decision: { verdict, limits, more_stones, more_s, asks_declaration } }) {
  const name = index === null ? `${sieve(sieve_mm)} mm` : index;
  if (verdict === "does_not_conform") {
    const [value, low, high] = [percent.value, limits.min_percent, limits.max_percent].map((each) => number(each));
    return word("operator.judged-outside", { name, percent: value, low, high });
  }
  if (more_stones === null) return asks_declaration ? word("operator.judged-declare", { name }) : name;
  const stones = number(more_stones);
  return more_s === null
    ? word("operator.judged-more-stones", { name, stones })
    : word("operator.judged-more-stones-and-time", { name, stones, time: span(more_s) });
}
