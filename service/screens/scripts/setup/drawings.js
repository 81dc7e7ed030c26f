/** The rig from above and from the side, with its cameras; the tiles below say the same in words. */

import { html, svg } from "../dom.js";
import { word } from "../words.js";

const SIDE_AZIMUTH_RAD = -Math.PI / 6;
/** The side is seen from beside the cameras' axes, so that none hides another. */

/** Draw the rig as seen from above and from the side; `choose` is called with the place that a person points at. */
export function drawings(rig, marks, choose) {
  const above = ({ center_mm: [x, y, z] }) => ({ across: x, up: y, near: z });
  const [cos, sin] = [Math.cos(SIDE_AZIMUTH_RAD), Math.sin(SIDE_AZIMUTH_RAD)];
  const side = ({ center_mm: [x, y, z] }) => ({ across: x * cos - y * sin, up: z, near: -(x * sin + y * cos) });
  const figure = (projected, text) => html.figure(draw(rig, marks, choose, projected), html.figcaption(text));
  return [figure(above, word("setup.places-above")), figure(side, word("setup.places-side"))];
}

function draw({ cameras }, marks, choose, projected) {
  const radius = Math.max(...cameras.map(({ center_mm: center }) => Math.hypot(...center)));
  const seen = cameras.map((camera) => ({ ...camera, ...projected(camera) })).sort((a, b) => a.near - b.near);
  const at = (mm) => (100 * mm) / radius;
  const marker = ({ id, across, up, near }) =>
    svg.g({ class: `marker${near < 0 ? " far" : ""}${marks.has(id) ? " found" : ""}`, transform: `translate(${at(across)} ${-at(up)})`, onclick: () => choose(id) },
      svg.circle({ r: near < 0 ? 10 : 12 }),
      svg.text({ "text-anchor": "middle", y: 4 }, id.replace(/^c0?/, "")),
    );
  return svg.svg({ viewBox: "-122 -122 244 244", class: "rig", "aria-hidden": "true" }, svg.circle({ class: "sphere", r: 100 }), svg.circle({ class: "stone", r: 5 }), seen.map(marker));
}
