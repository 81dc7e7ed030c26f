/** Buttons, forms and dialogs, which say what went wrong with what they do. */

import { html, setText, show } from "./dom.js";
import { language, word, wordOr } from "./words.js";

/** Return a button that does `action`, and the place beside it for what goes wrong. */
export function actionButton(key, action, attributes = {}) {
  const problem = html.span({ class: "problem", role: "alert" });
  const button = html.button({ type: "button", ...attributes, onclick: () => attempt(action, button, problem) }, word(key));
  return html.span({ class: "action" }, button, problem);
}

/** Return a button that asks first: pressed, it gives place to what `make` returns. */
export function askFirst(key, make, attributes = {}) {
  const place = html.span({ class: "action" });
  const ask = () => {
    show(place, make());
    place.querySelector("input, button").focus();
  };
  show(place, html.button({ type: "button", ...attributes, onclick: ask }, word(key)));
  return place;
}

/** Return a form that calls `action` with its values by name. */
export function makeForm(submitKey, action, ...fields) {
  const problem = html.p({ class: "problem", role: "alert" });
  const form = html.form(fields, html.div({ class: "buttons" }, html.button({ class: "main" }, word(submitKey))), problem);
  return onSubmit(form, action, problem);
}

/** Show a dialog until it is closed. */
export function openDialog(attributes, ...children) {
  const close = html.button({ type: "button", class: "main", onclick: () => dialog.close() }, word("forms.close"));
  const dialog = html.dialog({ onclose: () => dialog.remove(), ...attributes }, children, html.div({ class: "actions" }, close));
  document.body.append(dialog);
  dialog.showModal();
}

/** Return a dialog, closed yet, with a form that calls `action` with its values by name and closes once that is done. */
export function formDialog(titleKey, submitKey, action, ...fields) {
  const problem = html.p({ class: "problem", role: "alert" });
  const form = html.form(html.h2(word(titleKey)), fields, problem,
    html.div({ class: "actions" },
      html.button({ type: "button", onclick: () => dialog.close() }, word("forms.cancel")),
      html.button({ class: "main" }, word(submitKey)),
    ));
  const dialog = html.dialog({ "aria-label": word(titleKey) }, onSubmit(form, async (values) => {
    await action(values);
    dialog.close();
    form.reset();
  }, problem));
  document.body.append(dialog);
  return dialog;
}

/** Call `action` with the values of a form by name when it is submitted; what goes wrong is said in `problem`. */
export function onSubmit(form, action, problem, say = explained) {
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(() => action(Object.fromEntries(new FormData(form))), event.submitter, problem, say);
  });
  return form;
}

async function attempt(action, button, problem, say = explained) {
  button.disabled = true; // not twice
  setText(problem, "");
  try {
    await action();
  } catch (error) {
    setText(problem, say(error));
  }
  button.disabled = false;
}

/** Return what a refusal says, with what to do where that is known. */
export function explained(error) {
  if (error.status === 401) return word("forms.needs-key");
  if (error.status === 403) return word("forms.needs-other-key", { detail: error.detail });
  const kind = String(error.type ?? "").split(":").at(-1);
  return language() === "en" || !kind ? error.message : `${wordOr(`problem.${kind}`, error.title)} (${error.message})`;
}

/** Return a labelled field of a form; `input` has the attributes of the `<input>`. */
export const field = (key, input, hintKey = null) => html.label(word(key), html.input(input), hintKey && html.small(word(hintKey)));

/** Return a choice of one of several values, the first at first; `text` returns the words of a value. */
export const choices = (name, values, text) =>
  values.map((value, n) => html.label({ class: "choice" }, html.input({ type: "radio", name, value, checked: n === 0 }), html.span(text(value))));
