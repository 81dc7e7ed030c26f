/** The open lot, which can be closed, or the form that opens one; its name may be scanned. */

import { post } from "../api.js";
import { described, html, setText, showNew } from "../dom.js";
import { actionButton, askFirst, field, makeForm, openDialog } from "../forms.js";
import { number, time, word } from "../words.js";
import { reports, verdictOf } from "./list.js";

const WAIT_S = 60;
/** What the plant may say of a lot beside its name, and the attributes of the field. */
const SAID = ["external_id", "order", "customer", "equipment", "sublot", "sample_id", "sampler", "remark"];

/** Show the open lot in `place`, or the form for another; `onChange` is called after either has changed. */
export function showOpenLot(place, lot, products, onChange) {
  const choices = products.map(({ product, title }) => [product, title]);
  showNew(place, { lot: lot?.lot ?? null, choices }, () => (lot === null ? openForm(choices, onChange) : openLot(lot, onChange)));
  const count = place.querySelector(".stones");
  if (count) setText(count, number(lot.n_stones + lot.in_progress));
}

function openLot(lot, onChange) {
  const facts = [
    [word("lots.lot"), html.strong(lot.lot)],
    [word("lots.product"), `${lot.product}, ${word("lots.version", { version: lot.product_version })}`],
    [word("lots.opened"), time(lot.opened_at)],
    [word("lots.stones"), html.span({ class: "stones" })],
    ...SAID.filter((name) => lot[name] !== null).map((name) => [word(`lots.${name}`), lot[name]]),
  ];
  const closing = () => makeForm("lots.close", ({ tonnage }) => close(lot.lot, tonnage, onChange),
    field("lots.tonnage", { name: "tonnage", type: "number", min: 0, max: 1e6, step: "any", inputmode: "decimal" }, "lots.close-hint"));
  return [html.dl(described(facts)), html.div({ class: "actions" }, askFirst("lots.close-ask", closing, { class: "main" }))];
}

/** Close a lot, wait for the last of its stones, and say the verdict with its report. */
async function close(lot, tonnage, onChange) {
  const closed = await post(`/lots/${encodeURIComponent(lot)}/close?wait_s=${WAIT_S}`, tonnage === "" ? {} : { tonnage_t: Number(tonnage) });
  openDialog({ "aria-label": word("lots.closed-title", { lot }) },
    html.h2(word("lots.closed-title", { lot })),
    html.p({ class: "verdict" }, verdictOf(closed)),
    html.p(word("lots.closed-stones", { n: number(closed.n_stones) })),
    html.p(reports(closed)),
  );
  await onChange();
}

function openForm(choices, onChange) {
  if (choices.length === 0) return html.p({ class: "note" }, word("lots.needs-product"));
  const name = html.input({ name: "lot", required: true, maxlength: 64, autocomplete: "off", autocapitalize: "off", spellcheck: "false" });
  const form = makeForm("lots.open", async (values) => {
    await post("/lots", Object.fromEntries(Object.entries(values).filter(([, value]) => value !== "")));
    await onChange();
  },
    html.label(word("lots.lot"), name, html.small(word("lots.lot-hint"))),
    scanButton(name),
    html.label(word("lots.product"), html.select({ name: "product" }, choices.map(([value, title]) => html.option({ value }, `${value}: ${title}`)))),
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
