/** All cameras: what each saw last, and how well it sees. */

import { BASE } from "../api.js";
import { byId, element, setText, show } from "../dom.js";
import { ne107Symbol, ne107Word } from "../symbols.js";
import { number, span, word } from "../words.js";

const SHEET = `${BASE}/cameras/contact-sheet.jpg`;
const COLUMNS = 4; // of the sheet
const REFRESH_MS = 5000;
/** Field, unit, factor, digits after the point. */
const VALUES = [["brightness", "%", 100, 0], ["dust", "%", 100, 1], ["edge_width_px", "px", 1, 1], ["lost", "", 1, 0], ["temperature_c", "°C", 1, 0]];
let cameras = [];
let loadedAt = 0;

/** Show a tile of each camera; one that needs attention says so in words. */
export function showCameras({ cameras: now }) {
  if (now.map(({ id }) => id).join() !== cameras.map(({ id }) => id).join()) show(byId("camera-tiles"), now.map(tile));
  cameras = now;
  now.forEach(update);
  if (Date.now() - loadedAt > REFRESH_MS && document.visibilityState === "visible") loadSheet();
}

function tile({ id }) {
  return element(
    "li",
    { id: `camera-${id}` },
    element(
      "button",
      { type: "button", onclick: () => enlarge(id) },
      element("span", { class: "picture" }),
      element("span", { class: "name" }, element("b", {}, id), element("span", { class: "state" })),
      element("span", { class: "values" }, VALUES.map(([field]) => element("span", { "data-field": field }))),
    ),
  );
}

function update(camera) {
  const place = byId(`camera-${camera.id}`);
  const state = camera.state === "armed" ? camera.ne107 : `${camera.ne107} ${camera.state}`;
  if (place.dataset.state !== state) {
    place.dataset.state = state;
    place.dataset.ne107 = camera.ne107;
    const text = camera.state === "armed" ? ne107Word(camera.ne107) : word(`operator.camera-${camera.state}`);
    show(place.querySelector(".state"), ne107Symbol(camera.ne107), camera.ne107 === "good" && camera.state === "armed" ? element("span", { class: "only-read" }, text) : text);
  }
  VALUES.forEach((value) => setText(place.querySelector(`[data-field="${value[0]}"]`), told(camera, value)));
}

function told(camera, [field, unit, factor, digits]) {
  const value = camera[field] === null ? "–" : `${number(camera[field] * factor, digits)} ${unit}`.trim();
  return `${word(`operator.camera-value-${field}`)} ${value}`;
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
  const dialog = element(
    "dialog",
    { class: "camera", "aria-label": id, onclose: () => dialog.remove() },
    element("h2", {}, id, " · ", word(`operator.camera-${camera.state}`), " · ", ne107Word(camera.ne107)),
    camera.last_frame_age_s !== null && element("img", { src: `${BASE}/cameras/${encodeURIComponent(id)}/snapshot.png`, alt: word("operator.picture-of", { camera: id }) }),
    element("p", {}, VALUES.map((value) => told(camera, value)).join(" · ")),
    element("p", { class: "weak" }, age),
    ...camera.warnings.map((each) => element("p", { class: "problem" }, each)),
    element("div", { class: "actions" }, element("button", { type: "button", class: "main", onclick: () => dialog.close() }, word("operator.close"))),
  );
  document.body.append(dialog);
  dialog.showModal();
}
