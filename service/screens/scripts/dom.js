/** Elements made in code: data becomes text and attributes, never HTML. */

const SVG = "http://www.w3.org/2000/svg";

/** Return an element. Attributes `on...` are listeners; true is an empty attribute, null and false are none. */
export const element = (tag, attributes = {}, ...children) => fill(document.createElement(tag), attributes, children);

/** Return an element of an SVG drawing. */
export const svgElement = (tag, attributes = {}, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);

function fill(made, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (isNothing(value)) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value === true ? "" : String(value));
  }
  show(made, ...children);
  return made;
}

/** Return the children that are there: null, undefined and false are none. */
const present = (children) => children.flat().filter((child) => child !== null && child !== undefined && child !== false);

/** Return the drawing that this server sent as text. */
export function svgFromServer(text) {
  const root = new DOMParser().parseFromString(text, "image/svg+xml").documentElement;
  if (root.namespaceURI !== SVG) throw new Error("this is no SVG");
  return document.importNode(root, true);
}

/** Put `children`, lists of them flattened and null and false left out, in the place of what is in `place`. */
export const show = (place, ...children) => place.replaceChildren(...children.flat().filter((child) => !isNothing(child)));

/** Set a text only if it is another one, so that screen readers and the eye are left alone. */
export function setText(place, text) {
  if (place.textContent !== text) place.textContent = text;
}

const isNothing = (value) => value === null || value === undefined || value === false;

export const byId = (id) => document.getElementById(id);
