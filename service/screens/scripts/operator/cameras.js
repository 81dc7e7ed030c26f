/** All cameras: what each saw last, and how well it sees. */

import { BASE } from "../api.js";
import { byId, html, setText, showNew } from "../dom.js";
import { openDialog } from "../forms.js";
import { ne107Symbol, ne107Word } from "../symbols.js";
import { quantity, said, span, word } from "../words.js";

const SHEET = `${BASE}/cameras/contact-sheet.jpg`;
const COLUMNS = 4; // of the sheet
const REFRESH_MS = 5000;
/** Field, unit, factor, digits after the point. */
const VALUES = [["brightness", "%", 100, 0], ["dust", "%", 100, 1], ["edge_width_px", "px", 1, 1], ["lost", "", 1, 0], ["temperature_c", "°C", 1, 0]];
let cameras = [];
let loadedAt = 0;

/** Show a tile of each camera; one that needs attention says so in words. */
export function showCameras({ cameras: now }) {
  showNew(byId("camera-tiles"), now.map(({ id }) => id), () => now.map(tile));
  cameras = now;
  now.forEach(update);
  if (Date.now() - loadedAt > REFRESH_MS && document.visibilityState === "visible") loadSheet();
}

function tile({ id }) {
  return html.li({ id: `camera-${id}` },
    html.button({ type: "button", onclick: () => enlarge(id) },
      html.span({ class: "picture" }),
      html.span({ class: "name" }, html.b(id), html.span({ class: "state" })),
      html.span({ class: "values" }, VALUES.map(([field]) => html.span({ "data-field": field }))),
    ),
  );
}

function update(camera) {
  const { id, state, ne107 } = camera;
  const place = byId(`camera-${id}`);
  place.dataset.ne107 = ne107;
  showNew(place.querySelector(".state"), [state, ne107], () => {
    const text = state === "armed" ? ne107Word(ne107) : word(`operator.camera-${state}`);
    return [ne107Symbol(ne107), html.span({ class: ne107 === "good" && state === "armed" ? "only-read" : null }, text)];
  });
  VALUES.forEach((value) => setText(place.querySelector(`[data-field="${value[0]}"]`), told(camera, value)));
}

function told(camera, [field, unit, factor, digits]) {
  const value = camera[field] === null ? null : camera[field] * factor;
  return `${word(`operator.camera-value-${field}`)} ${quantity(value, digits, unit)}`;
}

/** Load the pictures of all cameras as one, and show each tile its part. */
function loadSheet() {
  loadedAt = Date.now();
  const sheet = new Image();
  sheet.addEventListener("load", () => {
    const rows = Math.ceil(cameras.length / COLUMNS);
    cameras.forEach(({ id }, index) => {
      const picture = byId(`camera-${id}`).querySelector(".picture");
      picture.style.backgroundImage = `url("${sheet.src}")`;
      picture.style.backgroundSize = `${COLUMNS * 100}% ${rows * 100}%`;
      picture.style.backgroundPosition = `${((index % COLUMNS) / (COLUMNS - 1)) * 100}% ${rows > 1 ? (Math.floor(index / COLUMNS) / (rows - 1)) * 100 : 0}%`;
      picture.style.aspectRatio = `${sheet.width / COLUMNS} / ${sheet.height / rows}`;
    });
  });
  sheet.src = `${SHEET}?at=${Math.floor(loadedAt / REFRESH_MS)}`;
}

function enlarge(id) {
  const camera = cameras.find((each) => each.id === id);
  const age = camera.last_frame_age_s === null ? word("operator.no-picture") : word("operator.picture-age", { age: span(camera.last_frame_age_s) });
  openDialog(
    { class: "camera", "aria-label": id },
    html.h2(id, " · ", word(`operator.camera-${camera.state}`), " · ", ne107Word(camera.ne107)),
    camera.last_frame_age_s !== null && html.img({ src: `${BASE}/cameras/${encodeURIComponent(id)}/snapshot.png`, alt: word("operator.picture-of", { camera: id }) }),
    html.p(VALUES.map((value) => told(camera, value)).join(" · ")),
    html.p({ class: "weak" }, age),
    camera.findings.map((each) => html.p({ class: "problem" }, said(each))),
  );
}
