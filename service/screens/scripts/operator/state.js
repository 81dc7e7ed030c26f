/** The state of the rig, the lot, and the verdict: what is read from three metres. */

import { byId, html, setText, showNew } from "../dom.js";
import { ne107Symbol, ne107Word, verdictSymbol } from "../symbols.js";
import { number, sieve, span, time, word } from "../words.js";

const GRAVEST_FIRST = ["does_not_conform", "insufficient", "undecided", "conforms", "not_measured"];

/** Show the state as symbol, word and reasons. */
export function showState({ acquisition, ne107, reasons }) {
  byId("state").dataset.ne107 = ne107;
  const text = acquisition.state === "armed" ? word(`operator.activity-${acquisition.activity}`) : word(`operator.state-${acquisition.state}`);
  setText(byId("state-word"), text);
  setText(byId("ne107"), word("operator.rig-is", { state: ne107Word(ne107) }));
  showNew(byId("state-symbol"), ne107, () => ne107Symbol(ne107));
  const told = [...new Set([acquisition.trouble, ...reasons])].filter((each) => each !== null);
  showNew(byId("reasons"), told, () => told.map((each) => html.li(each)));
  byId("reasons").title = told.join("\n"); // there is room for the first
  document.title = `${text} · stonefall`;
}

/** Show which lot takes what falls. */
export function showLot({ lot }) {
  setText(byId("lot-name"), lot === null ? word("operator.no-lot") : lot.lot);
  byId("largest").hidden = lot === null;
  byId("largest").href = `/gallery?${new URLSearchParams({ lot: lot?.lot ?? "", order: "heaviest" })}`;
  setText(
    byId("lot-product"),
    lot === null
      ? word("operator.no-lot-explained")
      : word("operator.lot-line", { product: lot.title || lot.product, stones: number(lot.n_stones), since: time(lot.opened_at) }),
  );
}

/** Show whether the lot conforms, and when it will be known. */
export function showVerdict({ figures }) {
  const verdict = figures?.verdict ?? "none";
  byId("verdict").dataset.verdict = verdict;
  showNew(byId("verdict-word"), verdict, () => [verdictSymbol(verdict), html.span(word(`operator.verdict-${verdict}`))]);
  const partial = figures?.is_partial ? word("operator.partial") : "";
  const told = [countdown(figures?.decisions ?? []), partial].join(" ").trim();
  setText(byId("countdown"), told);
  byId("countdown").title = told; // a wall has room for its beginning
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
