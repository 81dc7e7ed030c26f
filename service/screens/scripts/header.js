/** The head of every page: where one can go, language, theme, full screen, who is signed in, and what must not be missed. */

import { get, remove, session } from "./api.js";
import { byId, element, show } from "./dom.js";
import { LANGUAGES, language, speak, word } from "./words.js";

const PAGES = [["/", "header.operator"], ["/gallery", "header.gallery"], ["/compare", "header.compare"], ["/setup", "header.setup"]];
const THEMES = ["auto", "light", "dark"];

/** Fill `<header id="header">`; `current` is the address of this page. */
export function mountHeader(current) {
  const links = PAGES.map(([address, key]) =>
    element("a", { href: address, "aria-current": address === current && "page" }, word(key)));
  show(
    byId("header"),
    element("a", { class: "skip", href: "#main" }, word("header.skip")),
    element(
      "div",
      { class: "bar" },
      element("a", { class: "brand", href: "/" }, "stonefall"),
      element("nav", { "aria-label": word("header.navigation") }, ...links, element("a", { href: "/api/v1/docs" }, word("header.documentation"))),
      element("div", { class: "tools" }, element("span", { id: "who" }), languageButton(), themeButton(), fullScreenButton()),
    ),
    element("div", { id: "banners", role: "status" }),
  );
  window.addEventListener("sign-in-needed", () => showBanner("sign-in", word("header.sign-in-needed"), signInLink()));
  showWho();
  get("/overview").then(showOrigin).catch(() => {}); // a page that follows the rig calls it again
}

/** Say at the top of the page whether what it shows fell, or is made up or played. */
export function showOrigin({ is_simulated: isSimulated, is_replay: isReplay }) {
  const key = isSimulated ? "header.simulated" : isReplay ? "header.replayed" : null;
  if (key === null) hideBanner("origin");
  else showBanner("origin", word(key));
}

/** Show a banner; one of the same name is replaced. */
export function showBanner(name, text, ...more) {
  const banner = element("p", { class: `banner ${name}`, "data-name": name }, element("strong", {}, text), ...more);
  const before = byId("banners").querySelector(`[data-name="${name}"]`);
  if (before === null) byId("banners").append(banner);
  else if (before.textContent !== banner.textContent) before.replaceWith(banner);
}

/** Take a banner away. */
export const hideBanner = (name) => byId("banners").querySelector(`[data-name="${name}"]`)?.remove();

async function showWho() {
  const { who, scopes } = await session().catch(() => ({ who: null, scopes: [] }));
  document.documentElement.dataset.scopes = scopes.join(" ");
  if (who?.startsWith("key ")) show(byId("who"), who.slice(4), " ", element("button", { type: "button", onclick: signOut }, word("header.sign-out")));
  else if (!scopes.includes("operate")) show(byId("who"), signInLink());
}

const signInLink = () =>
  element("a", { class: "button", href: `/sign-in?next=${encodeURIComponent(location.pathname + location.search)}` }, word("header.sign-in"));

async function signOut() {
  await remove("/session");
  location.reload();
}

function languageButton() {
  const [other] = Object.keys(LANGUAGES).filter((each) => each !== language());
  return element("button", { type: "button", lang: other, onclick: () => speak(other) }, LANGUAGES[other]);
}

function themeButton() {
  const root = document.documentElement;
  const button = element("button", { type: "button", onclick: change });
  function change() {
    root.dataset.theme = THEMES[(THEMES.indexOf(root.dataset.theme) + 1) % THEMES.length];
    localStorage.setItem("theme", root.dataset.theme);
    name();
  }
  function name() {
    button.textContent = word(`header.theme-${root.dataset.theme}`);
  }
  name();
  return button;
}

function fullScreenButton() {
  if (!document.fullscreenEnabled) return null;
  const toggle = () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen());
  return element("button", { type: "button", onclick: toggle }, word("header.full-screen"));
}
