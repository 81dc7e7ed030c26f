/** The crusher's diary: what was changed at the crusher, and what that changed in the stones. */

import { get, post } from "../api.js";
import { byId, element, setText, show } from "../dom.js";
import { language, word } from "../words.js";

const KINDS = ["gap", "liner", "feed", "other"];

/** Let the button open the form; `onNoted` is called after an entry. */
export function mountDiary(onNoted) {
  const dialog = form(onNoted);
  document.body.append(dialog);
  byId("note").addEventListener("click", () => dialog.showModal());
}

/** Show what changed since the entries of the last hours. */
export async function showChanges(hours) {
  const { items } = await get(`/diary/changes?hours=${hours}&language=${language()}`).catch(() => ({ items: [] }));
  const told = items.flatMap((each) => each.figures).filter((each) => each.is_significant);
  show(byId("changes"), told.map((each) => element("li", {}, each.sentence)));
}

function form(onNoted) {
  const text = element("textarea", { name: "text", maxlength: 500, required: true });
  const value = element("input", { name: "value", type: "number", step: "any", min: 0 });
  const valueLabel = element("label", {}, word("diary.value"), value);
  const problem = element("p", { class: "problem", role: "alert" });
  const kinds = KINDS.map((kind, index) =>
    element("label", { class: "choice" }, element("input", { type: "radio", name: "kind", value: kind, checked: index === 0, onchange: showValue }), word(`diary.kind-${kind}`)));
  const body = element(
    "form",
    { method: "dialog", onsubmit: note },
    element("h2", { id: "diary-title" }, word("diary.title")),
    element("p", {}, word("diary.explained")),
    element("fieldset", {}, element("legend", {}, word("diary.kind")), ...kinds),
    valueLabel,
    element("label", {}, word("diary.text"), text),
    problem,
    element(
      "div",
      { class: "actions" },
      element("button", { type: "button", onclick: () => dialog.close() }, word("operator.cancel")),
      element("button", { class: "main" }, word("diary.note")),
    ),
  );
  const dialog = element("dialog", { "aria-labelledby": "diary-title" }, body);

  const kind = () => body.elements.kind.value;
  function showValue() {
    valueLabel.hidden = kind() !== "gap";
  }
  async function note(event) {
    event.preventDefault();
    setText(problem, "");
    const entry = { kind: kind(), text: text.value, ...(kind() === "gap" && value.value !== "" && { value: Number(value.value) }) };
    try {
      await post("/diary", entry);
      dialog.close();
      body.reset();
      showValue();
      onNoted();
    } catch (error) {
      setText(problem, error.message);
    }
  }
  return dialog;
}
