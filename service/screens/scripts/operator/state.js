/** The state of the rig, and the lot: what is read from three metres. */

import { ROOT } from "../api.js";
import { titled } from "../header.js";
import { byId, html, setText, showNew } from "../dom.js";
import { ne107Symbol, ne107Word } from "../symbols.js";
import { number, said, time, word } from "../words.js";

/** Show the state as symbol, word and reasons. */
export function showState({ acquisition, ne107, findings }) {
  byId("state").dataset.ne107 = ne107;
  const text = acquisition.state === "armed" ? word(`operator.activity-${acquisition.activity}`) : word(`operator.state-${acquisition.state}`);
  setText(byId("state-word"), text);
  setText(byId("ne107"), word("operator.rig-is", { state: ne107Word(ne107) }));
  showNew(byId("state-symbol"), ne107, () => ne107Symbol(ne107));
  const told = [...new Set(findings.map(said))];
  showNew(byId("reasons"), told, () => told.map((each) => html.li(each)));
  byId("reasons").title = told.join("\n"); // there is room for the first
  titled(text);
}

/** Show which lot takes what falls. */
export function showLot({ lot }) {
  setText(byId("lot-name"), lot === null ? word("operator.no-lot") : lot.lot);
  setText(byId("open-or-close"), word(lot === null ? "operator.open-lot" : "operator.close-lot"));
  byId("largest").hidden = lot === null;
  byId("largest").href = `${ROOT}gallery?${new URLSearchParams({ lot: lot?.lot ?? "", order: "heaviest" })}`;
  setText(
    byId("lot-product"),
    lot === null
      ? word("operator.no-lot-explained")
      : word("operator.lot-line", { product: lot.title || lot.product, stones: number(lot.n_stones), since: time(lot.opened_at) }),
  );
}
