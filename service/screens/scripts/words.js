/** Words, numbers and times in the language of the page. */

export const LANGUAGES = { en: "English", de: "Deutsch" };
const TIME = /^\d{4}-\d\d-\d\dT[\d:.]+Z$/;
/** Values that are names and have words, as in `service/base/messages.py`. */
const NAMES = new Set(["figure", "problem", "rules"]);
let words = {};

/** Return the language: of the address, else the one chosen before, else the browser's. */
export function language() {
  const { lang } = document.documentElement; // theme.js has set it
  return lang in LANGUAGES ? lang : "en";
}

/** Load the words, and put those of elements with `data-word` in their place. */
export async function loadWords() {
  const response = await fetch(new URL(`../words/${language()}.json`, import.meta.url));
  words = withBreaks(await response.json());
  document.documentElement.lang = language();
  for (const place of document.querySelectorAll("[data-word]")) place.textContent = word(place.dataset.word);
  for (const place of document.querySelectorAll("[data-word-label]")) place.setAttribute("aria-label", word(place.dataset.wordLabel));
}

/** Return the words with soft hyphens in the long ones, as no browser of Debian knows where to break them. */
function withBreaks({ "header.breaks": breaks, ...found }) {
  const places = breaks.split(" ").filter((each) => each !== "").map((each) => [each.replaceAll("-", ""), each.replaceAll("-", "\u00ad")]);
  const broken = (text) => places.reduce((text, [whole, parts]) => text.replaceAll(whole, parts), text);
  return Object.fromEntries(Object.entries(found).map(([key, text]) => [key, broken(text)]));
}

/** Remember the language and show the page in it. */
export function speak(chosen) {
  localStorage.setItem("language", chosen);
  const address = new URL(location.href);
  address.searchParams.delete("language");
  if (address.href === location.href) location.reload();
  else location.replace(address);
}

/** Return the words of a key, with `{name}` replaced by `values.name`, `{name:.1f}` and `{name:+.1f}` with so many digits.
 *
 * `{name|stone|stones}` is its first word if the value is one, else its second.
 */
export function word(key, values = {}) {
  const numbered = (words[key] ?? key).replace(/\{(\w+)\|([^|}]*)\|([^}]*)\}/g, (_, name, one, many) => (String(values[name]) === "1" ? one : many));
  return numbered.replace(/\{(\w+)(?::(\+?)(?:\.(\d)f|g))?\}/g, (_, name, sign, digits) => {
    const value = values[name];
    if (NAMES.has(name)) return String(value).split(", ").map(named).join(", ");
    if (sign === undefined) return TIME.test(value) ? time(value) : String(value);
    return (sign && value >= 0 ? "+" : "") + (digits === undefined ? value.toLocaleString(language()) : number(value, digits));
  });
}

/** Return the words of a name, in which `#` is the size of a sieve. */
function named(name) {
  const [, size] = name.match(/^passing_([\d.]+)_mm_percent$/) ?? [];
  return wordOr(`name.${size === undefined ? name : "passing_#_mm_percent"}`, name).replace("#", size === undefined ? "#" : sieve(Number(size)));
}

/** Return what the service says of itself: a finding, whose code has words in each language, after what it is about. */
export const said = ({ code, subjects, parameters }) => [...subjects.map(subject), word(`message.${code}`, parameters)].join(": ");

/** Codes that have words for all that they report. */
const COMPLETE = new Set([
  ...["silent", "in_use", "control_lost", "process_ended"].map((cause) => `device_${cause}`),
  "camera_misses", "camera_process_silent", "camera_process_replaced", "gate_counted", "verification_failed",
]);

/** Return the texts of other programs and devices, in English, that findings rest on and that their words leave out. */
export const leftOut = (findings) => (language() === "en" ? [] : findings
  .filter((each) => "reported" in each.parameters && !COMPLETE.has(each.code) && !said(each).includes(each.parameters.reported))
  .map(({ parameters }) => parameters.reported));

/** Return who asked, as the audit names those: a key by its name, or this machine. */
export function asker(who) {
  const name = who.replaceAll(" ", "-");
  return who.startsWith("key ") ? word("who.key", { name: who.slice(4) }) : wordOr(`who.${name}`, who);
}

function subject(name) {
  const [kind, ...rest] = name.split(":");
  return [wordOr(`subject.${kind}`, kind), ...rest].join(" ");
}

/** Return the words of a key, `other` where there are none. */
export const wordOr = (key, other) => words[key] ?? other;

/** Return the names that a family of words is of, in their order. */
export const family = (prefix) => Object.keys(words).filter((key) => key.startsWith(`${prefix}.`)).map((key) => key.slice(prefix.length + 1));

/** Return a number with so many digits after the point, a dash for none. */
export function number(value, digits = 0) {
  if (value === null || value === undefined) return "–";
  return value.toLocaleString(language(), { minimumFractionDigits: digits, maximumFractionDigits: digits });
}

/** Return a figure with its unit, a dash for none. */
export const quantity = (value, digits, unit) => (value === null || value === undefined ? "–" : `${number(value, digits)} ${unit}`.trim());

/** Return the size of a sieve, with as many digits as it needs. */
export const sieve = (sizeMm) => number(sizeMm, Number.isInteger(sizeMm) ? 0 : Math.min(3, String(sizeMm).split(".")[1].length));

/** How dates and times are written: of the English ones not the American. */
export const locale = () => (language() === "en" ? "en-GB" : language());

/** Return the local time of day of an RFC 3339 time, with the date unless it is today's. */
export function time(rfc3339) {
  const at = new Date(rfc3339);
  const isToday = at.toDateString() === new Date().toDateString();
  return at.toLocaleString(locale(), { ...(!isToday && { day: "numeric", month: "short" }), hour: "2-digit", minute: "2-digit", hourCycle: "h23" });
}

/** Return a moment with its date and year. */
export const moment = (rfc3339) => new Date(rfc3339).toLocaleString(locale(), { dateStyle: "medium", timeStyle: "short" });

/** Return a span of time in its greatest fitting unit, such as `3 min`. */
export function span(seconds) {
  const [unit, size] = [["day", 86_400], ["hour", 3600], ["minute", 60], ["second", 1]].find(([, size]) => seconds >= 2 * size) ?? ["second", 1];
  return Math.floor(seconds / size).toLocaleString(language(), { style: "unit", unit, unitDisplay: "short" });
}
