/** The endpoints that are told of events: what became of that, and to add, test, enable, send again and remove them. */

import { get, post, put, remove } from "../api.js";
import { poll } from "../asking.js";
import { html, show, showNew, table, wide } from "../dom.js";
import { actionButton, askFirst, field, makeForm } from "../forms.js";
import { number, time, word } from "../words.js";
import { columns, quoted, verdict } from "./wizard.js";

const POLL_S = 3;

/** Show the endpoints in `place`. */
export function mountWebhooks(place) {
  const list = html.div({ class: "card" }), told = html.div({ role: "status" });
  let nAnswered = 0;
  show(place, list, html.div({ class: "card step" }, html.h2(word("setup.webhook-new")), html.p(word("setup.webhook-what")), definition(), told));
  const again = poll(list, POLL_S, async () => {
    const { items } = await get("/webhooks").catch((error) => {
      showNew(list, error.message, () => html.p({ class: "problem" }, error.message));
      throw error;
    });
    const focused = list.contains(document.activeElement) ? document.activeElement : null;
    if (focused !== null && list.querySelector("form, .danger") !== null) return; // a person is being asked something
    showNew(list, [items, nAnswered], () => endpoints(items));
    if (focused && !focused.isConnected) list.querySelector(`[aria-label="${CSS.escape(focused.ariaLabel ?? "")}"]`)?.focus();
  });
  /** Show what follows from what a person was asked for. */
  const answered = () => {
    nAnswered += 1;
    document.activeElement.blur();
    return again();
  };

  /** Return the form of a new endpoint, or of other words for one that is there. */
  function definition() {
    return makeForm(
      "setup.webhook-define",
      async ({ name, url, events }) => {
        const chosen = events.split(/[,;\s]+/).filter((each) => each !== "");
        tellSecret(await put(path(name), { url, ...(chosen.length > 0 && { events: chosen }) }));
        await again();
      },
      html.div({ class: "fields" },
        field("setup.webhook-name", { name: "name", required: true, maxlength: 64, autocomplete: "off" }),
        field("setup.webhook-url", { name: "url", type: "url", required: true, maxlength: 2000, autocomplete: "off" }, "setup.webhook-url-hint"),
        field("setup.webhook-events", { name: "events", maxlength: 1000, autocomplete: "off" }, "setup.webhook-events-hint"),
      ),
    );
  }

  /** Say how it went; a secret that was made is nowhere else. */
  function tellSecret({ name, secret }) {
    show(told,
      verdict(true, word("setup.webhook-kept", { name })),
      secret !== null && html.p(word("setup.webhook-secret", { name }), " ", html.code({ class: "secret", tabindex: 0 }, secret)));
  }

  function tellAttempt(name, { status, problem, duration_ms: ms }) {
    show(told, verdict(problem === null, word(problem === null ? "setup.webhook-taken" : "setup.webhook-refused", { name, answer: problem ?? status, ms: number(ms) })));
  }

  function endpoints(items) {
    const rows = items.map((each) => [each.name, each.url, each.events.join(", "), state(each), actions(each)]);
    const heads = columns("webhook", "webhook-url", "webhook-events", "state", "actions");
    return [html.h2(word("setup.webhooks")), items.length === 0 ? html.p({ class: "weak" }, word("setup.webhook-none")) : wide(word("setup.webhooks"), table({}, heads, rows))];
  }

  function actions({ name, after, is_of_configuration: isFixed, n_secrets: nSecrets }) {
    const named = (key, attributes = {}) => ({ ...attributes, "aria-label": `${word(key)} ${name}` });
    const act = (key, action) => actionButton(key, () => action().then(again), named(key));
    const test = async () => tellAttempt(name, await post(`${path(name)}/test`));
    const anew = () => makeForm(
      "setup.webhook-replay-sure",
      async ({ event, all }) => {
        if (all) await post(`${path(name)}/replay`, { after: Number(event) - 1 });
        else tellAttempt(name, await post(`${path(name)}/resend`, { event: Number(event) }));
        await answered();
      },
      field("setup.webhook-event", { name: "event", type: "number", min: 1, required: true, value: Math.max(after, 1) }),
      html.label({ class: "choice" }, html.input({ type: "checkbox", name: "all" }), html.span(word("setup.webhook-all-since"))),
    );
    const end = () => actionButton("setup.webhook-remove-sure", () => remove(path(name)).then(answered), named("setup.webhook-remove-sure", { class: "danger" }));
    return html.td({ class: "cell-buttons" },
      act("setup.webhook-test", test),
      act("setup.webhook-enable", () => post(`${path(name)}/enable`)),
      askFirst("setup.webhook-replay", anew, named("setup.webhook-replay")),
      !isFixed && nSecrets === 1 && act("setup.webhook-rotate", () => put(`${path(name)}/secret`, {}).then(tellSecret)),
      !isFixed && nSecrets > 1 && act("setup.webhook-rotated", () => remove(`${path(name)}/secret`)),
      !isFixed && askFirst("setup.webhook-remove", end, named("setup.webhook-remove")),
    );
  }
}

const path = (name) => `/webhooks/${encodeURIComponent(name)}`;

/** Return how an endpoint is, in words. */
function state({ waiting, attempts, disabled_at: disabledAt, last_problem: problem, last_taken_at: taken, is_of_configuration: isFixed }) {
  const now = disabledAt !== null ? word("setup.webhook-disabled", { at: time(disabledAt) }) : attempts > 0 ? word("setup.webhook-failing", { n: number(attempts) }) : word("setup.webhook-good", { n: number(waiting) });
  return html.td(
    now,
    problem !== null && html.small({ class: "problem" }, " ", quoted(problem)),
    taken !== null && html.small(` ${word("setup.webhook-last", { at: time(taken) })}`),
    isFixed && html.small(` ${word("setup.webhook-fixed")}`),
  );
}
