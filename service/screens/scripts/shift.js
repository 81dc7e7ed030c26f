/** The sheet of a shift, as the server prints it: one page of A4. */

import { BASE, get, getText } from "./api.js";
import { latestOnly } from "./asking.js";
import { byId, html, htmlFromServer, setText, show } from "./dom.js";
import { showProblem, startPage } from "./header.js";
import { language, time, word } from "./words.js";

await startPage();
document.title = `${word("shift.title")} – stonefall`;
const { items: shifts } = await get("/shifts?limit=90").catch((error) => {
  showProblem(error);
  return { items: [] };
});
const asked = new URLSearchParams(location.search).get("shift");
if (asked !== null && !shifts.some(({ shift }) => shift === asked)) await get(`/shifts/${encodeURIComponent(asked)}`).then((found) => shifts.push(found), showProblem);
const choice = byId("shifts");
show(choice, shifts.map(({ shift, since, until, is_over: isOver }) =>
  html.option({ value: shift, selected: shift === asked }, `${time(since)} – ${time(until)}${isOver ? "" : ` (${word("shift.goes-on")})`}`)));
choice.addEventListener("change", () => showSheet(choice.value));
byId("print").addEventListener("click", () => window.print());
const latest = latestOnly();
const sheet = byId("sheet").attachShadow({ mode: "open" });
if (shifts.length > 0) showSheet(choice.value);

/** Show the sheet of a shift. */
function showSheet(shift) {
  const path = `/shifts/${encodeURIComponent(shift)}/sheet`;
  history.replaceState(null, "", `?shift=${encodeURIComponent(shift)}`);
  byId("pdf").href = `${BASE}${path}.pdf?language=${language()}`;
  latest(getText(`${path}.html?language=${language()}`)).then((text) => {
    setText(byId("problem"), "");
    show(sheet, ...htmlFromServer(text));
  }, showProblem);
}
