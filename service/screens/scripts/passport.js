/** The passport of one stone: its body, its views, its numbers, and what became of it. */

import { BASE, ROOT, get, put } from "./api.js";
import { byId, described, html, setText, show, table } from "./dom.js";
import { actionButton, onSubmit } from "./forms.js";
import { showProblem, startPage, titled } from "./header.js";
import { measuresTable } from "./measures.js";
import { qualityMark } from "./symbols.js";
import { showBody } from "./viewer.js";
import { showViews } from "./views.js";
import { language, locale, quantity, word } from "./words.js";

/** Return the number of a stone's first result, by which its neighbours are found. */
const numberOf = ({ id }) => Number(id.split("-")[1]);
const fullTime = (rfc3339) => new Date(rfc3339).toLocaleString(locale(), { dateStyle: "medium", timeStyle: "medium" });

await startPage();
const key = decodeURIComponent(location.pathname.split("/").at(-1));
// files are asked for by the same key: a number names one revision, an id the newest
get(`/particles/${encodeURIComponent(key)}`).then((stone) => showStone({ ...stone, key })).catch(showProblem);

async function showStone(stone) {
  titled(stone.id);
  setText(byId("title"), word("passport.stone", { id: stone.id }));
  const address = `${location.origin}${ROOT}stones/${stone.id}`;
  show(byId("address"), word("passport.address"), " ", html.a({ href: address }, address));
  byId("stone").hidden = false;
  showNumbers(stone);
  showFacts(stone);
  showPin(stone);
  if (stone.mesh !== null && stone.files_removed === null) showMesh(stone);
  else show(byId("body"), html.p({ class: "note" }, stone.files_removed ? word(`passport.removed-${stone.files_removed}`) : word("passport.no-body")));
  await Promise.all([showNeighbours(stone), showRevisions(stone), showAllViews(stone)]);
}

/** Return why a stone was not measured, with the details in the words of the service, which are English. */
function reasonOf({ reason, detail }) {
  if (reason === null) return null;
  const text = word(`operator.reason-${reason}`);
  return language() === "en" && detail !== null ? `${text}: ${detail}` : text;
}

function showNumbers(stone) {
  if (stone.outcome !== "measured") return show(byId("numbers"), html.p(word("passport.not-measured")));
  show(byId("numbers"), measuresTable(stone));
  get("/openapi.json").then(({ components }) => show(byId("numbers"), measuresTable(stone, components.schemas.Result))).catch(() => {});
}

async function showMesh(stone) {
  const path = `${BASE}/particles/${stone.key}`;
  const picture = byId("picture");
  const full = actionButton("passport.full-detail", async () => {
    await (await shown).refine(`${path}/mesh.glb`);
    full.hidden = true;
  });
  Object.assign(picture, { src: `${path}/preview.png`, alt: word("passport.picture", { id: stone.id }) });
  show(byId("downloads"), ["ply", "stl", "glb"].map((format) =>
    html.a({ class: "button", href: `${path}/mesh.${format}`, download: `${stone.id}.${format}` }, word("passport.download", { format: format.toUpperCase() }))),
  html.button({ type: "button", onclick: () => print() }, word("passport.print")), full);
  const shown = showBody(byId("body"), {
    mesh: `${path}/mesh.glb?detail=preview`,
    preview: `${path}/preview.png`,
    name: word("passport.stone", { id: stone.id }),
    result: stone,
    calipers: get(`/particles/${stone.key}/calipers`).catch(() => null),
  });
  const body = await shown;
  full.hidden = body === null;
  if (body === null) return;
  window.addEventListener("pagehide", ({ persisted }) => persisted || body.dispose());
  if (body.gauges.size === 0) return;
  byId("gauges").append(...[...body.gauges.keys()].map((name) => gaugeSwitch(body, name)));
  byId("gauges").hidden = false;
}

/** Return a switch for one gauge; those of the Ferets lie near others, and are off at first. */
function gaugeSwitch(body, name) {
  const isShown = !name.includes("feret");
  body.toggle(name, isShown);
  return html.label({ class: `switch ${name}` },
    html.input({ type: "checkbox", checked: isShown, onchange: ({ target }) => body.toggle(name, target.checked) }),
    html.span({ class: "swatch" }),
    html.span(body.gauges.get(name).text.textContent),
  );
}

/** Return whether raw frames of a stone may be kept, which its own record does not say. */
async function hasFrames(stone) {
  if (stone.files_removed !== null) return false;
  const page = await get(`/particles?has_frames=true&cursor=${numberOf(stone) + 1}&limit=1&fields=id`);
  return page.items[0]?.id === stone.id;
}

async function showAllViews(stone) {
  if (stone.outcome === "lost") return;
  const areKept = await hasFrames(stone);
  setText(byId("views-note"), word(areKept ? "passport.views-explained" : "passport.views-outline-only"));
  showViews(byId("views"), stone, areKept);
}

function showFacts(stone) {
  const facts = [
    ["revision", stone.revision > 1 && String(stone.revision)],
    ["outcome", word(`stone.outcome-${stone.outcome}`)],
    ["reason", reasonOf(stone)],
    ["quality", stone.quality && qualityMark(stone.quality)],
    ["causes", stone.quality_causes.map((cause) => word(`stone.cause-${cause}`)).join(", ")],
    ["body", stone.body && word(`stone.body-${stone.body}`)],
    ["captured", fullTime(stone.captured_at)],
    ["lot", stone.lot && html.a({ href: `${ROOT}gallery?lot=${encodeURIComponent(stone.lot)}` }, stone.lot)],
    ["views-used", stone.views.length > 0 && word("passport.views-used", { used: stone.views.length, all: stone.views.length + Object.keys(stone.dropped_views).length })],
    ["gate", stone.gate_extent_is_plausible === false && word("passport.gate-implausible")],
    ["calibration", stone.calibration_id && html.span({ title: stone.calibration_id }, stone.calibration_id.slice(0, 12))],
    ["verification", stone.verification && word(`passport.verification-${stone.verification}`)],
    ["algorithm", stone.algorithm_version],
    ["origin", stone.is_simulated ? word("passport.simulated") : stone.is_replay ? word("passport.replayed") : null],
  ];
  show(byId("facts"), described(facts.filter(([, value]) => value).map(([name, value]) => [word(`passport.fact-${name}`), value])));
}

function showPin(stone) {
  const problem = html.p({ class: "problem", role: "alert" });
  const change = async (pin) => {
    showPin(await put(`/particles/${stone.id}/pin`, pin));
    byId("pin").querySelector("button").focus();
  };
  const reason = html.label(word("passport.pin-reason"), html.input({ id: "pin-reason", name: "reason", maxlength: 300 }));
  show(byId("pin"), stone.is_pinned
    ? [html.p(html.strong(word("passport.pinned")), stone.pin_reason && `: ${stone.pin_reason}`), actionButton("passport.unpin", () => change({ is_pinned: false, reason: "" }))]
    : onSubmit(html.form(reason, html.button(word("passport.pin")), problem), ({ reason }) => change({ is_pinned: true, reason }), problem));
}

async function showNeighbours(stone) {
  const place = numberOf(stone);
  const [before, after] = await Promise.all([
    get(`/particles?cursor=${place}&limit=1&fields=id`).then(({ items }) => items[0]),
    get(`/results?after=${place}&limit=20&fields=id`).then(({ items }) => items.find(({ revision }) => revision === 1)),
  ].map((asked) => asked.catch(() => undefined)));
  const link = (found, relation, arrow) => found && html.a({ class: "button", rel: relation, href: `${ROOT}stones/${found.id}` }, arrow(word(`passport.${relation}`)));
  show(byId("neighbours"), link(before, "prev", (text) => `← ${text}`), link(after, "next", (text) => `${text} →`));
}

/** Show all that was said of the stone, back to its first result. */
async function showRevisions(stone) {
  const newest = await get(`/particles/${stone.id}`);
  if (newest.revises === null) return;
  const results = [newest];
  while (results.at(-1).revises !== null) results.push(await get(`/particles/${results.at(-1).revises}`));
  const heads = ["revision", "algorithm", "recorded", "sieve", "volume", "quality"].map((name) => word(`passport.revision-${name}`));
  const rows = results.map((each) => ({
    cells: [
      html.a({ href: `${ROOT}stones/${each.seq}` }, String(each.revision)),
      each.algorithm_version ?? "–",
      fullTime(each.recorded_at),
      quantity(each.sieve_size_mm, 2, "mm"),
      quantity(each.volume_mm3, 1, "mm³"),
      each.quality ? qualityMark(each.quality) : word(`stone.outcome-${each.outcome}`),
    ],
    "aria-current": each.revision === stone.revision && "true",
  }));
  show(byId("revisions"), table({}, heads, rows));
  byId("revisions-card").hidden = false;
}
