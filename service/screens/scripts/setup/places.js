/** The wizard of a rig's first start: one camera blinks, a person clicks the place where it does. */

import { BASE, get, post, put } from "../api.js";
import { poll } from "../asking.js";
import { html, rowHead, setText, showNew, table, wide } from "../dom.js";
import { actionButton, explained } from "../forms.js";
import { number, word } from "../words.js";
import { conclude, snippet } from "./conclusions.js";
import { drawings } from "./drawings.js";
import { rigInUse } from "./rig.js";
import { buttons, columns, finding, hands, makeWizard, note, progress, quoted, seeingNote, verdict } from "./wizard.js";

const STEPS = ["prepare", "find", "result"];
const SEEN = "rig-places";
/** Where this browser keeps what was seen so far, by the camera that blinked. */
const POLL_S = 2;
const BLINK_S = 60;
const PICTURES_WITHIN_MS = 20_000;

/** Show the wizard in `place`; it goes on where this browser left it. */
export function mountPlaces(place) {
  const wizard = makeWizard(place, "places", STEPS);
  let rig = null, cameras = [], acquisition = null, configured = null; // the configuration's cameras, null if not ours to read
  let seen = JSON.parse(localStorage.getItem(SEEN) ?? "{}");
  let step = Object.keys(seen).length === 0 ? "prepare" : "find";
  let lit = null, live = null, isTakingPictures = false; // `lit`: the camera that blinks, and until when
  const again = poll(place, POLL_S, async () => {
    rig ??= await rigInUse();
    configured ??= await get("/config").then(({ settings }) => settings.rig.cameras ?? [], () => []);
    [{ items: cameras }, acquisition] = await Promise.all([get("/cameras"), get("/acquisition")]);
    render();
  });

  function render() {
    if (rig === null || acquisition === null) return;
    wizard.enter(step, { prepare: prepareStep, find: findStep, result: resultStep }[step]);
    if (step !== "result") showNew(live.state, [acquisition.state, isTakingPictures], disarmedNote);
    if (step === "prepare") live.begin.querySelector("button").disabled = acquisition.state !== "disarmed";
    if (step === "find") showFinding();
  }

  function go(next) {
    step = next;
    render();
  }

  function remember(camera, found) {
    if (found === null) delete seen[camera];
    else seen[camera] = found;
    localStorage.setItem(SEEN, JSON.stringify(seen));
    render();
  }

  const waiting = () => cameras.map(({ id }) => id).filter((id) => !(id in seen));

  function disarmedNote() {
    if (acquisition.state === "disarmed" || isTakingPictures) return [];
    const stop = () => put("/acquisition", { state: "disarmed" }).then(again);
    return [note("setup.places-armed"), actionButton("setup.places-disarm", stop, { class: "main" })];
  }

  function prepareStep() {
    const begin = () => {
      go("find");
      return blink();
    };
    live = { state: html.div(), begin: actionButton("setup.places-begin", begin, { class: "main", disabled: true }) };
    return [html.p(word("setup.places-what")), hands("setup.places-two-people", "setup.places-production", "setup.places-lamp"), live.state, buttons(live.begin)];
  }

  function findStep() {
    live = { state: html.div(), status: html.div({ role: "status", class: "asked" }), tiles: html.div({ class: "rig-tiles" }), drawings: html.div({ class: "drawings" }), done: html.div() };
    return [
      live.state,
      live.status,
      buttons(
        actionButton("setup.places-blink", blink, { class: "main" }),
        actionButton("setup.places-none-blinks", noneBlinks),
        actionButton("setup.places-back", back),
        actionButton("setup.places-pictures", takePictures),
        actionButton("setup.places-to-result", () => go("result")),
      ),
      live.done,
      live.drawings,
      live.tiles,
    ];
  }

  /** Let the next camera that can blink, or the one that does for another minute; one that cannot is noted with why. */
  async function blink() {
    const camera = lit?.camera ?? waiting()[0];
    if (camera === undefined) return go("result");
    try {
      const { serial, address, seconds } = await post(`/cameras/${camera}/identify`, { seconds: BLINK_S });
      lit = { camera, serial, address, until: Date.now() + 1000 * seconds };
    } catch (error) {
      if (error.status !== 503) throw error;
      lit = null;
      remember(camera, { problem: error.detail, cause: error.cause });
      if (waiting().length > 0) return blink();
    }
    render();
  }

  /** Remember what was seen of the camera that blinks. */
  function answer(found) {
    const { camera, serial, address } = lit;
    lit = null;
    remember(camera, { serial, address, ...found });
  }

  async function noneBlinks() {
    if (lit !== null) answer({ cause: "unseen", problem: word("setup.places-unseen") });
    await blink();
  }

  async function back() {
    const last = Object.keys(seen).at(-1);
    lit = null;
    if (last === undefined) return go("prepare");
    remember(last, null);
    await blink();
  }

  async function choose(chosen) {
    if (lit === null) return;
    answer({ place: chosen });
    await blink().catch((error) => setText(live.status, explained(error)));
  }

  /** Arm the rig until every camera has exposed the empty rig, and disarm it again. */
  async function takePictures() {
    const before = new Map(cameras.map(({ id, frames }) => [id, frames]));
    const end = Date.now() + PICTURES_WITHIN_MS;
    isTakingPictures = true;
    lit = null;
    try {
      await put("/acquisition", { state: "armed" });
      do {
        await new Promise((resolve) => setTimeout(resolve, 500));
        ({ items: cameras } = await get("/cameras"));
      } while (Date.now() < end && cameras.some(({ id, state, frames }) => state !== "lost" && frames <= before.get(id)));
    } finally {
      await put("/acquisition", { state: "disarmed" });
      isTakingPictures = false;
      await again();
    }
  }

  function showFinding() {
    if (lit !== null && lit.until < Date.now()) lit.isOver = true;
    const n = Object.keys(seen).length;
    const unfound = Object.entries(seen).filter(([, { problem }]) => problem);
    showNew(live.status, [lit, waiting()[0], unfound], () => [html.p(asked()), unfound.map(([camera, { problem }]) => html.p({ class: "weak" }, `${camera}: `, quoted(problem)))]);
    showNew(live.done, [n, cameras.length], () => progress(word("setup.places-progress", { n, of: cameras.length }), n, cameras.length));
    const marks = new Map(Object.values(seen).filter((each) => each.place).map((each) => [each.place, each]));
    showNew(live.drawings, [lit !== null, [...marks.keys()]], () => drawings(rig, marks, choose));
    showNew(live.tiles, [lit !== null, seen, cameras.map(({ id, frames }) => [id, frames])], () => rig.layers.map(layerRow));
  }

  function asked() {
    if (lit === null) return waiting().length === 0 ? word("setup.places-all") : word("setup.places-next", { camera: waiting()[0] });
    return word(lit.isOver ? "setup.places-over" : "setup.places-asked", { camera: lit.camera, serial: lit.serial ?? "–" });
  }

  function layerRow(layer, n) {
    const name = word("setup.places-layer", { n: n + 1, of: rig.layers.length, elevation: number(layer[0].elevation_deg) });
    return html.section({ class: "layer", "aria-label": name }, html.h3(name), html.div({ class: "tiles" }, layer.map(tile)));
  }

  function tile({ id, azimuth_deg: azimuth }) {
    const here = Object.entries(seen).filter(([, found]) => found.place === id);
    const shown = here.length > 0 ? here[0][0] : id;
    const camera = cameras.find((each) => each.id === shown);
    const words = here.length === 0 ? word("setup.places-not-yet") : here.map(([name, { serial }]) => `${serial ?? name}`).join(" + ");
    return html.button({ type: "button", class: here.length === 0 ? "tile" : "tile found", "data-place": id, disabled: lit === null, onclick: () => choose(id) },
      html.strong(id),
      html.span(`${number((azimuth + 360) % 360)}°`),
      camera?.frames > 0 ? html.img({ src: `${BASE}/cameras/${shown}/snapshot.png?at=${camera.frames}`, alt: word("setup.places-picture", { camera: shown }) }) : html.span({ class: "no-picture" }, word("setup.places-no-picture")),
      html.span({ class: "serial" }, here.length === 0 ? "" : "✓ ", words),
    );
  }

  function resultStep() {
    const { rows, findings } = conclude(seen, rig, cameras, configured);
    const file = html.textarea({ readonly: true, rows: 16, spellcheck: "false", "aria-label": word("setup.places-snippet") }, snippet(rows, configured));
    const anew = () => {
      seen = {};
      localStorage.removeItem(SEEN);
      go("prepare");
    };
    return [
      verdict(findings.length === 0, word(findings.length === 0 ? "setup.places-agree" : "setup.places-contradict", { n: findings.length })),
      findings.length > 0 && html.ul({ class: "findings" }, findings.map(({ code, values, detail }) => finding(html.strong(word(`setup.place-finding-${code}`, values)), quoted(detail)))),
      html.div({ class: "columns" }, placeTable(rows), html.div(html.h3(word("setup.places-snippet")), file, copyButtons(file))),
      seeingNote(),
      html.h3(word("setup.places-run-next")),
      html.ol({ class: "hands" }, ["check", "restart", "again", "calibrate"].map((key) => html.li(word(`setup.places-then-${key}`)))),
      html.pre("stonefall check-config /etc/stonefall/stonefall.toml\nsudo systemctl restart stonefall\nstonefall cameras"),
      buttons(
        actionButton("setup.places-continue", () => go("find")),
        actionButton("setup.places-anew", anew),
        html.a({ class: "button", href: "#calibration" }, word("setup.wizard-calibration")),
      ),
    ];
  }
}

function placeTable(rows) {
  const cells = ({ place, found }) => [
    rowHead(place),
    found.map(({ serial }) => serial ?? "?").join(" + ") || "–",
    found.map(({ camera }) => (camera === place ? "✓" : camera)).join(" + ") || "–",
  ];
  return wide(word("setup.wizard-places"), table({ class: "places" }, columns("place", "serial", "configured-as"), rows.map(cells)));
}

/** Return buttons that copy and download a text; the clipboard's own interface is missing on pages that come without TLS. */
function copyButtons(file) {
  const copied = html.span({ role: "status" });
  const copy = () => {
    file.select();
    document.execCommand("copy");
    setText(copied, word("setup.copied"));
  };
  const address = URL.createObjectURL(new Blob([file.value], { type: "text/plain" }));
  return buttons(
    html.button({ type: "button", class: "main", onclick: copy }, word("setup.copy")),
    html.a({ class: "button", download: "cameras.toml", href: address }, word("setup.download")),
    copied,
  );
}
