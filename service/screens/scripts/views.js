/** What the cameras saw of a stone: the picture where it is kept, the outline over it, cut to the stone. */

import { BASE, getText } from "./api.js";
import { html, show, svg, svgFromServer } from "./dom.js";
import { openDialog } from "./forms.js";
import { number, word } from "./words.js";

const MARGIN = 0.12;

/** Show the views of a stone, each when it comes into sight. */
export function showViews(place, stone, hasFrames) {
  const cameras = [...new Set([...stone.views, ...Object.keys(stone.dropped_views)])].sort();
  const figures = cameras.map((camera) => figure(stone, camera, hasFrames));
  show(place, ...figures.map(({ shown }) => shown));
  const inSight = new IntersectionObserver((entries) => {
    for (const { isIntersecting, target } of entries) {
      if (!isIntersecting) continue;
      inSight.unobserve(target);
      figures.find(({ shown }) => shown === target).load();
    }
  }, { rootMargin: "50%" });
  for (const { shown } of figures) inSight.observe(shown);
  window.addEventListener("beforeprint", () => figures.forEach(({ load }) => load()));
}

function figure(stone, camera, hasFrames) {
  const why = stone.dropped_views[camera];
  const residualPx = stone.view_residuals_px?.[camera];
  const button = html.button({ type: "button", class: "view", "aria-label": word("passport.enlarge", { camera }) });
  const shown = html.figure({ "data-camera": camera },
    button,
    html.figcaption(
      html.strong(camera),
      why ? html.span({ class: "unused" }, ` ⊘ ${word("passport.view-unused")}: ${why}`)
        : residualPx === undefined ? "" : ` ${word("passport.view-residual", { px: number(residualPx, 2) })}`,
    ),
  );
  let loading = null;
  const load = () => (loading ??= fill());
  async function fill() {
    if (!(camera in stone.segmenters)) return showNothing("passport.view-not-arrived");
    const outline = await getText(`/particles/${stone.key}/views/${camera}/outline.svg`).catch(() => null);
    if (outline === null && !hasFrames) return showNothing("passport.view-not-kept");
    const drawing = outline === null ? svg.svg({ viewBox: "0 0 1280 1024" }) : svgFromServer(outline);
    drawing.querySelector("style")?.remove(); // it is that of a file of its own, and would hold for the whole page
    drawing.classList.add("outlined");
    drawing.setAttribute("role", "img");
    drawing.setAttribute("aria-label", word("passport.view-label", { camera }));
    drawing.removeAttribute("width");
    drawing.removeAttribute("height");
    const whole = drawing.getAttribute("viewBox");
    show(button, drawing);
    cut(drawing);
    if (hasFrames) addPicture(drawing, stone, camera, whole);
    button.addEventListener("click", () => enlarge(drawing, camera, whole));
  }
  function showNothing(why) {
    show(button, html.span(word(why)));
    button.removeAttribute("aria-label");
    button.disabled = true;
  }
  return { shown, load };
}

/** Show what is drawn and a margin alone. */
function cut(drawing) {
  const { x, y, width, height } = drawing.getBBox();
  if (width === 0 || height === 0) return;
  const edge = (1 + 2 * MARGIN) * Math.max(width, height);
  drawing.setAttribute("viewBox", [x + (width - edge) / 2, y + (height - edge) / 2, edge, edge].join(" "));
}

function addPicture(drawing, stone, camera, whole) {
  const [, , width, height] = whole.split(" ").map(Number);
  const picture = svg.image({ href: `${BASE}/particles/${stone.key}/views/${camera}.png`, width, height });
  picture.addEventListener("error", () => picture.remove());
  drawing.prepend(picture);
}

function enlarge(drawing, camera, whole) {
  const copy = drawing.cloneNode(true);
  copy.setAttribute("viewBox", whole);
  const name = word("passport.view-label", { camera });
  openDialog({ class: "enlarged", "aria-label": name }, html.h2(name), copy);
}
