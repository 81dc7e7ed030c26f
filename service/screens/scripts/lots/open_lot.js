/** The open lot, which can be closed or give place to one of another product, or the form that opens one; names may be scanned. */

import { post } from "../api.js";
import { described, html, setText, showNew } from "../dom.js";
import { actionButton, askFirst, field, makeForm, openDialog } from "../forms.js";
import { number, time, word } from "../words.js";
import { reports, verdictOf } from "./list.js";

const WAIT_S = 60;
/** What the plant may say of a lot beside its name, and the attributes of the field. */
const SAID = ["external_id", "order", "customer", "equipment", "sublot", "sample_id", "sampler", "remark"];

/** Show the open lot in `place`, or the form for one of `product` at first; `onChange` is called after either has changed. */
export function showOpenLot(place, lot, product, products, onChange) {
  const choices = products.map(({ product, title }) => [product, title]);
  showNew(place, { lot: lot?.lot ?? null, choices }, () => (lot === null ? openForm(choices, product, onChange) : openLot(lot, choices, onChange)));
  const count = place.querySelector(".stones");
  if (count) setText(count, number(lot.n_stones + lot.in_progress));
}

/** Put what is typed beside all fields, as by a scanner, into the name of the lot to open. */
export function takeScans(place) {
  document.addEventListener("keydown", ({ key, ctrlKey, altKey, metaKey }) => {
    const isTyped = key.length === 1 && key !== " " && !ctrlKey && !altKey && !metaKey;
    if (isTyped && document.activeElement === document.body) place.querySelector("[name=lot]")?.focus();
  });
}

function openLot(lot, choices, onChange) {
  const facts = [
    [word("lots.lot"), html.strong(lot.lot)],
    [word("lots.product"), `${lot.product}, ${word("lots.version", { version: lot.product_version })}`],
    [word("lots.opened"), time(lot.opened_at)],
    [word("lots.stones"), html.span({ class: "stones" })],
    ...SAID.filter((name) => lot[name] !== null).map((name) => [word(`lots.${name}`), lot[name]]),
  ];
  const closing = () => makeForm("lots.close", ({ tonnage }) => close(lot.lot, tonnage, onChange),
    field("lots.tonnage", { name: "tonnage", type: "number", min: 0, max: 1e6, step: "any", inputmode: "decimal" }, "lots.close-hint"));
  const other = choices.find(([product]) => product !== lot.product)?.[0];
  const changing = () => [html.p({ class: "note" }, word("lots.change-hint", { lot: lot.lot })), openForm(choices, other, onChange, lot.lot)];
  return [html.dl(described(facts)),
    html.div({ class: "actions" }, askFirst("lots.change-ask", changing), askFirst("lots.close-ask", closing, { class: "main" }))];
}

/** Close a lot, wait for the last of its stones, and say the verdict with its report. */
async function close(lot, tonnage, onChange) {
  const closed = await post(`/lots/${encodeURIComponent(lot)}/close?wait_s=${WAIT_S}`, tonnage === "" ? {} : { tonnage_t: Number(tonnage) });
  openDialog({ "aria-label": word("lots.closed-title", { lot }) },
    html.h2(word("lots.closed-title", { lot })),
    html.p({ class: "verdict" }, verdictOf(closed)),
    html.p(word("lots.closed-stones", { n: number(closed.n_stones) })),
    html.p(word("lots.reports"), ": ", reports(closed)),
  );
  await onChange();
}

/** Return the form that opens a lot of `product` at first, in the place of the open one that it `closes`. */
function openForm(choices, product, onChange, closes = null) {
  if (choices.length === 0) return html.p({ class: "note" }, word("lots.needs-product"));
  const name = html.input({ name: "lot", required: true, maxlength: 64, autocomplete: "off", autocapitalize: "off", spellcheck: "false" });
  const form = makeForm(closes ? "lots.change" : "lots.open", async (values) => {
    await post("/lots", { ...Object.fromEntries(Object.entries(values).filter(([, value]) => value !== "")), ...(closes && { closes }) });
    await onChange();
  },
    html.label(word("lots.lot"), name, html.small(word("lots.lot-hint"))),
    scanButton(name),
    html.label(word("lots.product"), html.select({ name: "product" }, choices.map(([value, title]) => html.option({ value, selected: value === product }, `${value}: ${title}`)))),
    html.details(html.summary(word("lots.more-of-lot")), SAID.map((each) => field(`lots.${each}`, { name: each, maxlength: 200, autocomplete: "off" }))),
  );
  return form;
}

/** Return a button that reads a code with the tablet's camera; nothing where the browser cannot, or may not without TLS. */
function scanButton(name) {
  if (!("BarcodeDetector" in window) || !navigator.mediaDevices) return null;
  return html.div({ class: "buttons" }, actionButton("lots.scan", async () => {
    name.value = await scanned();
    name.focus();
  }));
}

async function scanned() {
  const stream = await navigator.mediaDevices.getUserMedia({ video: { facingMode: "environment" } });
  const video = html.video({ autoplay: true, muted: true, playsinline: true });
  video.srcObject = stream;
  const dialog = html.dialog({ class: "scan", "aria-label": word("lots.scan") }, video,
    html.div({ class: "actions" }, html.button({ type: "button", onclick: () => dialog.close() }, word("forms.cancel"))));
  document.body.append(dialog);
  dialog.showModal();
  try {
    const detector = new BarcodeDetector();
    while (dialog.open) {
      const [code] = video.readyState < HTMLMediaElement.HAVE_CURRENT_DATA ? [] : await detector.detect(video);
      if (code) return code.rawValue.trim();
      await new Promise((done) => setTimeout(done, 100));
    }
    throw new Error(word("lots.not-scanned"));
  } finally {
    stream.getTracks().forEach((track) => track.stop());
    dialog.remove();
  }
}
