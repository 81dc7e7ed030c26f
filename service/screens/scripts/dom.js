/** Elements made in code: data becomes text and attributes, never HTML. */

const SVG = "http://www.w3.org/2000/svg";

/**
 * Elements by tag: `html.p({ class: "note" }, text)`, `html.p(text)`. Attributes `on...` are listeners; true is an
 * empty attribute, null and false are none.
 */
export const html = elements((tag) => document.createElement(tag));

/** Elements of SVG drawings by tag. */
export const svg = elements((tag) => document.createElementNS(SVG, tag));

function elements(create) {
  const make = (tag) => (...given) => {
    const hasAttributes = given[0]?.constructor === Object;
    return fill(create(tag), hasAttributes ? given[0] : {}, hasAttributes ? given.slice(1) : given);
  };
  return new Proxy({}, { get: (_, tag) => make(tag) });
}

function fill(made, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (isNothing(value)) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value === true ? "" : String(value));
  }
  show(made, ...children);
  return made;
}

/**
 * Return a table. A row is a list of cells, or `{ cells, ...attributes }`; a cell that is no <td> or <th> is put into one.
 *
 * @param {number[]} figures the columns of figures, which are aligned to the right
 */
export function table(attributes, heads, rows, figures = []) {
  const kind = (column) => figures.includes(column) && "number";
  const isCell = (content) => content instanceof HTMLTableCellElement;
  const head = (content, column) => (isCell(content) ? content : html.th({ scope: "col", class: kind(column) }, content));
  const cell = (content, column) => (isCell(content) ? content : html.td({ class: kind(column) }, content));
  const row = ({ cells, ...attributes }) => html.tr(attributes, cells.map(cell));
  const body = rows.map((each) => row(Array.isArray(each) ? { cells: each } : each));
  return html.table(attributes, html.thead(html.tr(heads.map(head))), html.tbody(body));
}

/** Return a place in which what is too wide scrolls, also by keys, so that the page never does. */
export const wide = (name, ...children) => html.div({ class: "wide", tabindex: 0, role: "group", "aria-label": name }, children);

/** Return the cell of a figure with its confidence interval, which stands out if it has changed. */
export const figureCell = (text, interval, isChanged, ...more) =>
  html.td({ class: isChanged ? "number changed" : "number" }, text, interval && html.div({ class: "weak interval" }, interval), more);

/** Return the head of a row. */
export const rowHead = (...children) => html.th({ scope: "row" }, children);

/** Return what stands in a <dl>: names, and what each has. */
export const described = (facts) => facts.map(([name, value]) => html.div(html.dt(name), html.dd(value)));

/** Return the drawing that this server sent as text. */
export function svgFromServer(text) {
  const root = new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
  if (root.namespaceURI !== SVG) throw new Error("this is no SVG");
  return document.importNode(root, true);
}

/** Return what the document that this server sent as text has, with its style, to be put into a shadow root; no script of it runs. */
export function htmlFromServer(text) {
  const main = new DOMParser().parseFromString(text, "text/html").querySelector("main");
  const style = main.ownerDocument.querySelector("style");
  return [document.importNode(style, true), html.div({ class: main.className }, [...document.importNode(main, true).childNodes])];
}

/** Put `children`, lists of them flattened and null and false left out, in the place of what is in `place`. */
export const show = (place, ...children) => place.replaceChildren(...children.flat(Infinity).filter((child) => !isNothing(child)));

const shown = new WeakMap();

/** Put what `make` returns into `place` if `data`, which that shows, is not what was shown there last. */
export function showNew(place, data, make) {
  const text = JSON.stringify(data);
  if (shown.get(place) === text) return;
  shown.set(place, text);
  show(place, make());
}

/** Set a text only if it is another one, so that screen readers and the eye are left alone. */
export function setText(place, text) {
  if (place.textContent !== text) place.textContent = text;
}

const isNothing = (value) => value === null || value === undefined || value === false;

export const byId = (id) => document.getElementById(id);
