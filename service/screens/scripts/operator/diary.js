/** The crusher's diary: what was changed at the crusher, and what that changed in the stones. */

import { get, post } from "../api.js";
import { byId, html, show } from "../dom.js";
import { choices, field, formDialog } from "../forms.js";
import { language, word } from "../words.js";

const KINDS = ["gap", "liner", "feed", "other"];

/** Let the button open the form; `onNoted` is called after an entry. */
export function mountDiary(onNoted) {
  const gap = field("diary.value", { name: "value", type: "number", step: "any", min: 0 });
  const dialog = formDialog(
    "diary.title",
    "diary.note",
    async ({ kind, text, value }) => {
      await post("/diary", { kind, text, ...(kind === "gap" && value !== "" && { value: Number(value) }) });
      gap.hidden = false; // the form begins anew
      onNoted();
    },
    html.p(word("diary.explained")),
    html.fieldset({ onchange: ({ target }) => (gap.hidden = target.value !== "gap") },
      html.legend(word("diary.kind")),
      choices("kind", KINDS, (kind) => word(`diary.kind-${kind}`)),
    ),
    gap,
    html.label(word("diary.text"), html.textarea({ name: "text", maxlength: 500, required: true })),
  );
  byId("note").addEventListener("click", () => dialog.showModal());
}

/** Show what changed since the entries of the last hours. */
export async function showChanges(hours) {
  const { items } = await get(`/diary/changes?hours=${hours}&language=${language()}`).catch(() => ({ items: [] }));
  const told = items.flatMap((each) => each.figures).filter((each) => each.is_significant);
  show(byId("changes"), told.map((each) => html.li(each.sentence)));
}
