/** The head of every page: language, theme, full screen, who is signed in, and what must not be missed. */

import { ROOT, get, remove } from "./api.js";
import { poll } from "./asking.js";
import { byId, html, setText, show } from "./dom.js";
import { explained } from "./forms.js";
import { LANGUAGES, language, loadWords, locale, speak, word } from "./words.js";

const SITE = document.title; // names of plant and instrument, and "stonefall"
const MOST_HELD_MS = 700;
const RENEW_S = 3600;
const THEMES = ["auto", "light", "dark"];

let nAwaited = 0;
const paint = () => (document.documentElement.dataset.painted ??= "");

/** Hold the first paint until `promise` is settled, or `MOST_HELD_MS` are over: what is painted shall not move then. */
export function holdPaint(promise) {
  nAwaited += 1;
  promise.catch(() => {}).then(() => --nAwaited === 0 && requestAnimationFrame(paint));
}

/** Put words on the page and what one can choose into its head; every page begins with it. */
export async function startPage() {
  const worded = loadWords(), overview = get("/overview"); // beside the words
  overview.catch(() => {}); // it may fail before the words are there
  window.addEventListener("sign-in-needed", () => worded.then(() => isSignIn() || showBanner("sign-in", word("header.sign-in-needed"), signInLink(), pairLink())));
  await worded.catch((error) => {
    paint();
    throw error;
  });
  setTimeout(paint, MOST_HELD_MS);
  show(byId("tools"), html.span({ id: "who" }), languageButton(), themeButton(), document.fullscreenEnabled && fullScreenButton());
  mountMenu();
  holdPaint(new Promise((known) => poll(byId("who"), RENEW_S, () => showWho().finally(known)))); // asking renews the session
  window.addEventListener("beforeprint", notePrint);
  notePrint();
  holdPaint(overview.then(showOrigin)); // a page that follows the rig calls it again
}

/** Open and close what a narrow page has room for in a menu only. */
function mountMenu() {
  const menu = byId("menu");
  const isOpen = () => menu.getAttribute("aria-expanded") === "true";
  const open = (isWanted) => menu.setAttribute("aria-expanded", String(isWanted));
  menu.addEventListener("click", () => open(!isOpen()));
  document.addEventListener("click", ({ target }) => target.closest("#menu, #choices") || open(false));
  document.addEventListener("keydown", ({ key }) => {
    if (key !== "Escape" || !isOpen()) return;
    open(false);
    menu.focus();
  });
}

/** Put what the page shows before the name of the site, in the title of its tab. */
export const titled = (text) => (document.title = `${text} – ${SITE}`);

/** Say why the page does not show what was asked for. */
export const showProblem = (error) => setText(byId("problem"), explained(error));

/** Say at the top of the page whether what it shows fell, or is made up or played, in its tab in which state the rig is; and on a print, of which rig it is. */
export function showOrigin({ is_simulated: isSimulated, is_replay: isReplay, ne107, rig }) {
  const icon = new URL(`../icons/${ne107}.svg`, import.meta.url).href;
  const link = document.querySelector("link[rel=icon]");
  if (link.href !== icon) link.href = icon;
  setText(byId("printed-rig"), rig ?? "");
  showBanner("origin", isSimulated ? word("header.simulated") : isReplay ? word("header.replayed") : null);
}

/** Show a banner in the place of one of the same name; null takes it away. */
export function showBanner(name, text, ...more) {
  const before = byId("banners").querySelector(`[data-name="${name}"]`);
  if (text !== null && before?.firstChild.textContent === text) return;
  before?.remove();
  if (text !== null) byId("banners").append(html.p({ class: `banner ${name}`, "data-name": name }, html.strong(text), more));
}

/** Write on a print when it is made. */
const notePrint = () => setText(byId("printed-at"), new Date().toLocaleString(locale(), { dateStyle: "full", timeStyle: "long" }));

async function showWho() {
  const { who, scopes } = await get("/session").catch(() => ({ who: null, scopes: [] }));
  if (who?.startsWith("key ")) show(byId("who"), who.slice(4), " ", button(word("header.sign-out"), () => remove("/session").then(() => location.reload())));
  else if (!scopes.includes("operate")) show(byId("who"), signInLink());
}

const isSignIn = () => location.pathname === `${ROOT}sign-in`;
const signInAddress = () => `${ROOT}sign-in?next=${encodeURIComponent(location.pathname + location.search + location.hash)}`;
const signInLink = () => html.a({ class: "button", href: signInAddress() }, word("header.sign-in"));
const pairLink = () => html.a({ class: "button", href: `${signInAddress()}#pair` }, word("header.pair"));

const button = (text, onclick, attributes = {}) => html.button({ type: "button", onclick, ...attributes }, text);

function languageButton() {
  const [other] = Object.keys(LANGUAGES).filter((each) => each !== language());
  return button(LANGUAGES[other], () => speak(other), { lang: other });
}

function themeButton() {
  const { dataset } = document.documentElement;
  const made = button(word(`header.theme-${dataset.theme}`), () => {
    dataset.theme = THEMES[(THEMES.indexOf(dataset.theme) + 1) % THEMES.length];
    localStorage.setItem("theme", dataset.theme);
    made.textContent = word(`header.theme-${dataset.theme}`);
  });
  return made;
}

const fullScreenButton = () =>
  button(word("header.full-screen"), () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen()));
