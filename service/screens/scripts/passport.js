/** The passport of one stone: its body, its views, its numbers, and what became of it. */

import { BASE, get, put } from "./api.js";
import { byId, element, setText, show } from "./dom.js";
import { mountHeader } from "./header.js";
import { measuresTable } from "./measures.js";
import { qualityMark } from "./quality.js";
import { showBody } from "./viewer.js";
import { showViews } from "./views.js";
import { loadWords, locale, number, word } from "./words.js";

await loadWords();
mountHeader("/gallery");
const key = decodeURIComponent(location.pathname.split("/").at(-1));
try {
  // files are asked for by the same key: a number names one revision, an id the newest
  await showStone({ ...(await get(`/particles/${encodeURIComponent(key)}`)), key });
} catch (error) {
  setText(byId("problem"), error.message);
}

async function showStone(stone) {
  document.title = `${stone.id} – stonefall`;
  setText(byId("title"), word("passport.stone", { id: stone.id }));
  const address = `${location.origin}/stones/${stone.id}`;
  show(byId("address"), word("passport.address"), " ", element("a", { href: address }, address));
  byId("stone").hidden = false;
  showNumbers(stone);
  showFacts(stone);
  showPin(stone);
  const frames = hasFrames(stone);
  const hasMesh = stone.mesh !== null && stone.files_removed === null;
  if (hasMesh) showMesh(stone);
  else show(byId("body"), element("p", { class: "note" }, stone.files_removed ? word(`passport.removed-${stone.files_removed}`) : word("passport.no-body")));
  await Promise.all([showNeighbours(stone), showRevisions(stone), frames.then((areKept) => showAllViews(stone, areKept))]);
}

function showNumbers(stone) {
  if (stone.outcome !== "measured") return show(byId("numbers"), element("p", {}, word("passport.not-measured")));
  show(byId("numbers"), measuresTable(stone));
  get("/openapi.json").then(({ components }) => show(byId("numbers"), measuresTable(stone, components.schemas.Result))).catch(() => {});
}

async function showMesh(stone) {
  const path = `${BASE}/particles/${stone.key}`;
  const picture = byId("picture");
  Object.assign(picture, { src: `${path}/preview.png`, alt: word("passport.picture", { id: stone.id }) });
  show(byId("downloads"), ...["ply", "stl", "glb"].map((format) =>
    element("a", { class: "button", href: `${path}/mesh.${format}`, download: `${stone.id}.${format}` }, word("passport.download", { format: format.toUpperCase() }))),
  element("button", { type: "button", onclick: () => print() }, word("passport.print")));
  const body = await showBody(byId("body"), {
    mesh: `${path}/mesh.glb`,
    preview: `${path}/preview.png`,
    name: word("passport.stone", { id: stone.id }),
    result: stone,
    calipers: get(`/particles/${stone.key}/calipers`).catch(() => null),
  });
  if (body === null || body.gauges.size === 0) return;
  byId("gauges").append(...[...body.gauges.keys()].map((name) => gaugeSwitch(body, name)));
  byId("gauges").hidden = false;
  window.addEventListener("pagehide", ({ persisted }) => persisted || body.dispose());
}

/** Return a switch for one gauge; those of the Ferets lie near others, and are off at first. */
function gaugeSwitch(body, name) {
  const isShown = !name.includes("feret");
  body.toggle(name, isShown);
  return element(
    "label",
    { class: `switch ${name}` },
    element("input", { type: "checkbox", checked: isShown, onchange: ({ target }) => body.toggle(name, target.checked) }),
    element("span", { class: "swatch" }),
    element("span", {}, body.gauges.get(name).text.textContent),
  );
}

/** Return whether raw frames of a stone may be kept, which its own record does not say. */
async function hasFrames(stone) {
  if (stone.outcome === "lost" || stone.files_removed !== null) return false;
  const page = await get(`/particles?has_frames=true&cursor=${numberOf(stone) + 1}&limit=1&fields=id`);
  return page.items[0]?.id === stone.id;
}

async function showAllViews(stone, areKept) {
  if (stone.outcome === "lost") return;
  setText(byId("views-note"), word(areKept ? "passport.views-explained" : "passport.views-outline-only"));
  showViews(byId("views"), stone, areKept);
}

/** Return the number of a stone's first result, by which its neighbours are found. */
function numberOf({ id }) {
  return Number(id.split("-")[1]);
}

function showFacts(stone) {
  const facts = [
    ["revision", stone.revision > 1 && String(stone.revision)],
    ["outcome", word(`stone.outcome-${stone.outcome}`)],
    ["reason", stone.detail ?? stone.reason],
    ["quality", stone.quality && qualityMark(stone.quality)],
    ["causes", stone.quality_causes.map((cause) => word(`stone.cause-${cause}`)).join(", ")],
    ["body", stone.body && word(`stone.body-${stone.body}`)],
    ["captured", fullTime(stone.captured_at)],
    ["lot", stone.lot && element("a", { href: `/gallery?lot=${encodeURIComponent(stone.lot)}` }, stone.lot)],
    ["views-used", stone.views.length > 0 && word("passport.views-used", { used: stone.views.length, all: stone.views.length + Object.keys(stone.dropped_views).length })],
    ["gate", stone.gate_extent_is_plausible === false && word("passport.gate-implausible")],
    ["calibration", stone.calibration_id && element("span", { title: stone.calibration_id }, stone.calibration_id.slice(0, 12))],
    ["verification", stone.verification && word(`passport.verification-${stone.verification}`)],
    ["algorithm", stone.algorithm_version],
    ["origin", stone.is_simulated ? word("passport.simulated") : stone.is_replay ? word("passport.replayed") : null],
  ];
  show(byId("facts"), ...facts.filter(([, value]) => value).map(([name, value]) =>
    element("div", {}, element("dt", {}, word(`passport.fact-${name}`)), element("dd", {}, value))));
}

function fullTime(rfc3339) {
  return new Date(rfc3339).toLocaleString(locale(), { dateStyle: "medium", timeStyle: "medium" });
}

function showPin(stone) {
  const problem = element("p", { class: "problem", role: "alert" });
  const reason = element("input", { id: "pin-reason", maxlength: 300 });
  const change = async (isPinned) => {
    try {
      const changed = await put(`/particles/${stone.id}/pin`, { is_pinned: isPinned, reason: reason.value });
      showPin(changed);
      byId("pin").querySelector("button").focus();
    } catch (error) {
      setText(problem, error.message);
    }
  };
  if (stone.is_pinned) {
    show(byId("pin"), element("p", {}, element("strong", {}, word("passport.pinned")), stone.pin_reason ? `: ${stone.pin_reason}` : ""),
      element("button", { type: "button", onclick: () => change(false) }, word("passport.unpin")), problem);
  } else {
    show(byId("pin"), element("form", { onsubmit: (event) => { event.preventDefault(); change(true); } },
      element("label", {}, word("passport.pin-reason"), reason), element("button", {}, word("passport.pin")), problem));
  }
}

async function showNeighbours(stone) {
  const place = numberOf(stone);
  const [before, after] = await Promise.all([
    get(`/particles?cursor=${place}&limit=1&fields=id`).then(({ items }) => items[0]),
    get(`/results?after=${place}&limit=20&fields=id`).then(({ items }) => items.find(({ revision }) => revision === 1)),
  ].map((asked) => asked.catch(() => undefined)));
  const link = (found, relation, arrow) => found && element("a", { class: "button", rel: relation, href: `/stones/${found.id}` }, arrow(word(`passport.${relation}`)));
  show(byId("neighbours"), link(before, "prev", (text) => `← ${text}`), link(after, "next", (text) => `${text} →`));
}

/** Show all that was said of the stone, back to its first result. */
async function showRevisions(stone) {
  const newest = await get(`/particles/${stone.id}`);
  if (newest.revises === null) return;
  const results = [newest];
  while (results.at(-1).revises !== null) results.push(await get(`/particles/${results.at(-1).revises}`));
  const columns = ["revision", "algorithm", "recorded", "sieve", "volume", "quality"];
  show(byId("revisions"), element(
    "table", {},
    element("thead", {}, element("tr", {}, ...columns.map((name) => element("th", { scope: "col" }, word(`passport.revision-${name}`))))),
    element("tbody", {}, ...results.map((each) => element(
      "tr", { "aria-current": each.revision === stone.revision && "true" },
      element("td", {}, element("a", { href: `/stones/${each.seq}` }, String(each.revision))),
      ...[each.algorithm_version ?? "–", fullTime(each.recorded_at), `${number(each.sieve_size_mm, 2)} mm`, `${number(each.volume_mm3, 1)} mm³`].map((text) => element("td", {}, text)),
      element("td", {}, each.quality ? qualityMark(each.quality) : word(`stone.outcome-${each.outcome}`)),
    ))),
  ));
  byId("revisions-card").hidden = false;
}
