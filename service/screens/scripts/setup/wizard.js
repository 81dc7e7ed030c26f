/** What all wizards are made of: steps, words for the hands, and what happened before. */

import { get, put } from "../api.js";
import { poll } from "../asking.js";
import { html, show, showNew } from "../dom.js";
import { actionButton, field } from "../forms.js";
import { language, said, word } from "../words.js";

/**
 * Return a wizard in `place` with the steps of these names; `enter` shows one of them, and does nothing if it is
 * shown already, so that what a person types stays. `showPast` shows below what happened before.
 */
export function makeWizard(place, name, steps) {
  const items = steps.map((step) => html.li(word(`setup.${name}-step-${step}`)));
  const body = html.div({ class: "step card" });
  const below = html.div({ class: "below" });
  show(place, html.ol({ class: "steps", "aria-label": word("setup.steps") }, items), body, below);
  let shown = null;
  return {
    showPast: (data, make) => showNew(below, data, () => html.div({ class: "card" }, make())),
    enter(step, make) {
      if (step === shown) return;
      const isFirst = shown === null;
      shown = step;
      const current = steps.indexOf(step);
      items.forEach((item, number) => {
        item.className = number < current ? "done" : "";
        item.ariaCurrent = number === current ? "step" : null;
      });
      const heading = html.h2({ tabindex: -1 }, word("setup.step", { n: current + 1, of: steps.length, what: word(`setup.${name}-step-${step}`) }));
      show(body, heading, make());
      if (!isFirst) heading.focus({ preventScroll: true });
    },
  };
}

/** Return words that say what to do with one's hands, a list item each. */
export const hands = (...keys) => html.ul({ class: "hands" }, keys.map((key) => html.li(word(key))));

/** Return the sentence that says how it ended. */
export const verdict = (isGood, ...text) => html.p({ class: isGood ? "verdict good" : "verdict bad" }, text);

/** Return the buttons of a step. */
export const buttons = (...children) => html.div({ class: "buttons" }, children);

/** Return a note on what keeps the rig from seeing or solving, with its detail. */
export const note = (key, detail = null) => html.p({ class: "note" }, html.strong(word(key)), detail && [" ", detail]);

/** Return a text of others, which is English: marked as such, in quotes, on pages of another language. */
export const quoted = (text) => text && (language() === "en" ? text : html.q({ lang: "en" }, text));

/** Return what findings say, where there are none the text. */
export const told = (findings, text) => (findings.length > 0 ? findings.map(said).join("; ") : quoted(text));

/** Return what is to be put right: each in words, with its detail. */
export const finding = (text, detail = null, isFatal = true) => html.li({ class: isFatal ? "fatal" : "" }, text, detail && html.small(detail));

/** Return the fields for a person's name and remark, `by` and `note`. */
export const signature = () =>
  html.div({ class: "fields" }, field("setup.by", { name: "by", maxlength: 200, autocomplete: "name" }), field("setup.note", { name: "note", maxlength: 2000 }));

/** Return the heads of the columns of a table. */
export const columns = (...keys) => keys.map((key) => word(`setup.column-${key}`));

/** Return a bar of progress with its words. */
export const progress = (text, value, max) => html.div({ class: "progress" }, html.progress({ value, max, "aria-label": text }), html.span(text));

/** Return a note that says so while the rig sees nothing of what falls, with a button that arms it. */
export function seeingNote() {
  const place = html.div({ class: "seeing" });
  const again = poll(place, 3, async () => {
    const { state, trouble } = await get("/acquisition");
    const arm = () => put("/acquisition", { state: "armed" }).then(again);
    showNew(place, [state, trouble], () => {
      if (state === "armed") return null;
      if (state === "disarmed") return [note("setup.not-armed"), actionButton("setup.arm", arm, { class: "main" })];
      return note(`setup.rig-${state}`, trouble);
    });
  });
  return place;
}
