/** Products: what they must be, changed in a form that shows the differences before it saves another version. */

import { get, put } from "../api.js";
import { html, rowHead, show, table } from "../dom.js";
import { field, makeForm, openDialog } from "../forms.js";
import { number, sieve, word } from "../words.js";

const NUMBERS = ["density_kg_m3", "lower_mm", "upper_mm"];
const NAMES = ["sieve_set", "specification", "flakiness_category", "shape_category"];
const FIELDS = ["title", ...NUMBERS, ...NAMES];

/** Return the table of products; `onSave` is called after one was changed. */
export const productsTable = (products, onSave) =>
  html.div({ class: "wide", tabindex: 0 }, table({},
    ["product", "sizes", "specification", "density", "actions"].map((column) => word(`lots.${column}`)),
    products.map((each) => [
      rowHead(each.product, html.div({ class: "weak" }, `${each.title}, ${word("lots.version", { version: each.version })}`)),
      each.upper_mm === null ? "–" : `${sieve(each.lower_mm ?? 0)}/${sieve(each.upper_mm)}`,
      [nameOf(each.specification), each.flakiness_category, each.shape_category].filter((name) => name !== null).join(", ") || "–",
      `${number(each.density_kg_m3)} kg/m³`,
      html.button({ type: "button", onclick: () => editProduct(each, onSave) }, word("lots.edit")),
    ]), [3]));

/** Return a value in words: sieves and limits of the site's own have apertures, or a name within, in the place of a name. */
function nameOf(value) {
  if (typeof value === "number") return sieve(value);
  return Array.isArray(value) ? value.map(sieve).join(" ") : value?.name ?? value;
}

/** Ask for what a product is, null for a new one; it is saved once the differences were seen. */
export async function editProduct(product, onSave) {
  const { sieve_sets: sets, specifications } = await get("/products/standards");
  const choices = { sieve_set: sets.map(({ name }) => name), specification: specifications, flakiness_category: specifications.filter((name) => name.startsWith("FI")), shape_category: specifications.filter((name) => name.startsWith("SI")) };
  const differences = html.div({ role: "status" });
  let seen = null; // the definition whose differences are shown
  const form = makeForm("lots.save", async ({ product: name, ...values }) => {
    const wanted = definition(product, values);
    if (product !== null && seen !== JSON.stringify(wanted)) return showDifferences(wanted);
    const saved = await put(`/products/${encodeURIComponent(product?.product ?? name)}`, wanted);
    show(differences, html.p(word("lots.saved", { product: saved.product, version: saved.version })));
    await onSave();
  },
    product === null && field("lots.product", { name: "product", required: true, maxlength: 64, autocomplete: "off" }, "lots.product-hint"),
    field("lots.title-of-product", { name: "title", required: true, maxlength: 200, value: product?.title ?? "" }),
    NUMBERS.map((name) => field(`lots.${name}`, { name, type: "number", min: 0, step: "any", required: name === "density_kg_m3", inputmode: "decimal", value: product?.[name] ?? "" })),
    NAMES.map((name) => choice(name, product?.[name] ?? (name === "sieve_set" ? "en-basic-2" : null), choices[name])),
    differences,
  );

  function showDifferences(wanted) {
    const changed = FIELDS.filter((name) => JSON.stringify(product[name]) !== JSON.stringify(wanted[name] ?? null));
    seen = changed.length === 0 ? null : JSON.stringify(wanted);
    const lines = changed.map((name) => html.li(word("lots.difference", { field: word(`lots.${name === "title" ? "title-of-product" : name}`), before: nameOf(product[name]) ?? "–", after: nameOf(wanted[name] ?? null) ?? "–" })));
    show(differences, changed.length === 0 ? html.p(word("lots.no-differences")) : [html.p(word("lots.see-differences", { version: product.version + 1 })), html.ul(lines)]);
  }

  const title = product === null ? word("lots.new-product") : word("lots.edit-title", { product: product.product });
  openDialog({ "aria-label": title, class: "product" }, html.h2(title), form);
}

/** Return the definition that the form has: own sieves and limits, which it cannot show, stay as they are. */
function definition(product, values) {
  const { product: _, version: __, created_at: ___, ...before } = product ?? {};
  const given = Object.fromEntries(FIELDS.map((name) => [name, NUMBERS.includes(name) && values[name] !== "" ? Number(values[name]) : values[name] || null]));
  const own = Object.fromEntries(NAMES.filter((name) => values[name] === OWN).map((name) => [name, before[name]]));
  return Object.fromEntries(Object.entries({ ...before, ...given, ...own }).filter(([, value]) => value !== null));
}

const OWN = "\u0000"; // no name of a set or a specification

function choice(name, value, names) {
  const isOwn = value !== null && typeof value !== "string";
  const options = [isOwn && html.option({ value: OWN }, nameOf(value)), name !== "sieve_set" && html.option({ value: "" }, "–"), names.map((each) => html.option({ value: each, selected: each === value }, each))];
  return html.label(word(`lots.${name}`), html.select({ name }, options));
}
