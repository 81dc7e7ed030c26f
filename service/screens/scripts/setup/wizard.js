/** What all wizards are made of: steps, words for the hands, and buttons that say what went wrong. */

import { get, put } from "../api.js";
import { element, setText, show } from "../dom.js";
import { word } from "../words.js";
import { poll } from "./polling.js";

/**
 * Return a wizard in `place` with the steps of these names; `enter` shows one of them, and does nothing if it is
 * shown already, so that what a person types stays.
 */
export function makeWizard(place, name, steps) {
  const items = steps.map((step) => element("li", {}, word(`setup.${name}-step-${step}`)));
  const body = element("div", { class: "step card" });
  const below = element("div", { class: "below" });
  show(place, element("ol", { class: "steps", "aria-label": word("setup.steps") }, ...items), body, below);
  let shown = null;
  return {
    below,
    enter(step, make) {
      if (step === shown) return;
      const isFirst = shown === null;
      shown = step;
      const current = steps.indexOf(step);
      items.forEach((item, number) => {
        item.className = number < current ? "done" : "";
        item.toggleAttribute("aria-current", false);
        if (number === current) item.setAttribute("aria-current", "step");
      });
      const heading = element("h2", { tabindex: -1 }, word("setup.step", { n: current + 1, of: steps.length, what: word(`setup.${name}-step-${step}`) }));
      show(body, heading, ...make());
      if (!isFirst) heading.focus({ preventScroll: true });
    },
  };
}

/** Return words that say what to do with one's hands, a paragraph or list item each. */
export const hands = (...keys) => element("ul", { class: "hands" }, ...keys.map((key) => element("li", {}, word(key))));

/** Return a button; while `action` runs it cannot be pressed, and what goes wrong is said beside it. */
export function actionButton(key, action, attributes = {}) {
  const problem = element("span", { class: "problem", role: "alert" });
  const button = element("button", { type: "button", ...attributes, onclick: press }, word(key));
  async function press() {
    button.disabled = true;
    setText(problem, "");
    try {
      await action();
    } catch (error) {
      setText(problem, explained(error));
    }
    button.disabled = false;
  }
  return element("span", { class: "action" }, button, problem);
}

/** Return a form that calls `action` with its values by name; attributes as of `element`. */
export function makeForm(submitKey, action, ...fields) {
  const problem = element("p", { class: "problem", role: "alert" });
  const button = element("button", { class: "main" }, word(submitKey));
  const form = element("form", { onsubmit: submit }, ...fields, element("div", { class: "buttons" }, button), problem);
  async function submit(event) {
    event.preventDefault();
    button.disabled = true;
    setText(problem, "");
    try {
      await action(Object.fromEntries(new FormData(form)));
    } catch (error) {
      setText(problem, explained(error));
    }
    button.disabled = false;
  }
  return form;
}

/** Return a labelled field of a form; `input` has the attributes of the `<input>`. */
export const field = (key, input, hintKey = null) =>
  element("label", {}, word(key), element("input", input), hintKey && element("small", {}, word(hintKey)));

/** Return what a refusal says, with what to do where that is known. */
export function explained(error) {
  if (error.status === 401) return word("setup.needs-key");
  if (error.status === 403) return word("setup.needs-other-key", { detail: error.detail });
  return error.detail ?? error.message;
}

/** Return a bar of progress with its words. */
export function progress(text, value, max) {
  return element("div", { class: "progress" }, element("progress", { value, max, "aria-label": text }), element("span", {}, text));
}

/** Return a note that says so while the rig sees nothing of what falls, with a button that arms it. */
export function seeingNote() {
  const place = element("div", { class: "seeing" });
  let before = null;
  const again = poll(3, async () => {
    const { state, trouble } = await get("/acquisition");
    if (state + trouble === before) return;
    before = state + trouble;
    if (state === "armed") show(place);
    else if (state === "disarmed") {
      show(
        place,
        element("p", { class: "note" }, element("strong", {}, word("setup.not-armed"))),
        actionButton("setup.arm", () => put("/acquisition", { state: "armed" }).then(again), { class: "main" }),
      );
    } else show(place, element("p", { class: "note" }, element("strong", {}, word(`setup.rig-${state}`)), trouble && ` ${trouble}`));
  });
  return place;
}

/** Put `children` into `place` if `data`, which they show, is not what was shown last. */
export function showNew(place, data, make) {
  const text = JSON.stringify(data);
  if (place.dataset.shown === text) return;
  place.dataset.shown = text;
  show(place, ...make());
}
