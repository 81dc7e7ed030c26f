/** A screen is signed in by the code that it shows: which one it is, its name, and what it is for. */

import { get, post } from "../api.js";
import { html, show } from "../dom.js";
import { choices, field, makeForm } from "../forms.js";
import { time, word } from "../words.js";
import { verdict } from "./wizard.js";

const ROLES = ["display", "operator", "engineer"];

/** Ask in `place` for the code of a screen; the QR code that it shows leads here with it. */
export function mountScreens(place) {
  const found = html.div({ "aria-live": "polite" });
  const given = new URLSearchParams(location.search).get("code") ?? "";
  const find = async ({ code }) => showScreen(found, await get(path(code)), await get("/session"));
  const input = { name: "code", value: given, required: true, inputmode: "numeric", pattern: "[0-9]{3} ?[0-9]{3}", maxlength: 7, autocomplete: "off" };
  const form = makeForm("setup.screen-find", find, field("setup.screen-code", input, "setup.screen-code-hint"));
  show(place, html.div({ class: "card step" }, html.h2(word("setup.screen-pair")), html.p(word("setup.screen-what")), form, found));
  if (given !== "") form.requestSubmit(form.querySelector("button"));
}

function showScreen(place, { code, address, user_agent: agent, opened_at: openedAt }, { has_keys: hasKeys, keyless }) {
  const confirm = async ({ name, role }) => {
    const paired = await post(`${path(code)}/confirm`, { name: name.trim(), role });
    show(place, verdict(true, word("setup.screen-paired", { name: paired.name })), html.p(word("setup.screen-revoke", { name: paired.name })));
  };
  show(place,
    html.p(html.strong(word("setup.screen-is", { address, agent, at: time(openedAt) }))),
    html.p(word("setup.screen-sure")),
    !hasKeys && html.div({ class: "problem" },
      html.p(word("setup.screen-first-key")),
      html.ul(keyless.map((each) => html.li(`${each.address} ${each.user_agent}`)))),
    makeForm("setup.screen-confirm", confirm,
      field("setup.screen-name", { name: "name", required: true, maxlength: 64, pattern: "[A-Za-z0-9_.\\-]+", autocomplete: "off" }, "setup.screen-name-hint"),
      html.fieldset(html.legend(word("setup.screen-role")), choices("role", ROLES, (role) => word(`setup.screen-role-${role}`)))));
}

const path = (code) => `/pairings/${encodeURIComponent(code.replace(" ", ""))}`;
