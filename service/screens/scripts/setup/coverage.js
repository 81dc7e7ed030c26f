/** Where balls were seen so far, in space and in each image, and what to drop next. */

import { html, svg } from "../dom.js";
import { number, quantity, word, wordOr } from "../words.js";
import { cameraTowards, project } from "./rig.js";
import { quoted } from "./wizard.js";

const PLANES = [["setup.space-above", 0, 1], ["setup.space-side", 0, 2], ["setup.space-front", 1, 2]];
const AXES = ["x", "y", "z"];
const HORIZONTAL = { "+x": [1, 0], "-x": [-1, 0], "+y": [0, 1], "-y": [0, -1] };

/** Return in words for the hands what to drop next. */
export function wanted({ n_drops: nDrops, reaches_mm: reaches, cameras, goals, is_sufficient: isSufficient }, rig) {
  if (isSufficient) return html.p({ class: "verdict good" }, word("setup.coverage-sufficient"));
  const items = [];
  if (nDrops < goals.n_drops) items.push(word("setup.coverage-more", { n: goals.n_drops - nDrops }));
  for (const [direction, reach] of Object.entries(reaches)) {
    if (reach >= goals.reach_mm) continue;
    const values = { direction, reach: number(reach, 1), goal: number(goals.reach_mm, 1) };
    items.push(
      direction in HORIZONTAL
        ? word("setup.coverage-towards", { ...values, camera: cameraTowards(rig.cameras, HORIZONTAL[direction]).id })
        : word(direction === "+z" ? "setup.coverage-higher" : "setup.coverage-lower", values),
    );
  }
  const blind = Object.entries(cameras).filter(([, seen]) => seen.n_drops < Math.min(goals.n_drops_per_camera, nDrops));
  if (blind.length > 0) {
    items.push(word("setup.coverage-cameras", { cameras: blind.map(([camera, seen]) => `${camera} (${seen.n_drops})`).join(", "), goal: goals.n_drops_per_camera }));
  }
  return [html.h3(word("setup.coverage-next")), html.ul({ class: "next" }, items.map((item) => html.li(item)))];
}

/** Draw the balls in space, from above and from two sides; the square is what they shall reach beyond. */
export function spaceCoverage(drops, { goals, extent_mm: extent }, rig) {
  const centers = drops.map(({ center_mm: center }) => center).filter((center) => center !== null);
  const reach = 1.2 * Math.max(2 * goals.reach_mm, ...centers.flat().map(Math.abs));
  const words = word("setup.space-words", { n: centers.length, x: number(extent[0], 1), y: number(extent[1], 1), z: number(extent[2], 1) });
  return [
    html.h3(word("setup.space")),
    html.div({ class: "planes" }, PLANES.map(([key, across, up]) => html.figure(plane(centers, across, up, reach, goals.reach_mm, rig), html.figcaption(word(key))))),
    html.p({ class: "weak" }, words),
  ];
}

function plane(centers, across, up, reach, goal, rig) {
  const at = (mm) => (100 * mm) / reach;
  const label = (axis, sign) => {
    const direction = [0, 0];
    if (axis < 2) direction[axis] = sign;
    const camera = axis < 2 ? ` ${cameraTowards(rig.cameras, direction).id}` : "";
    return `${sign > 0 ? "+" : "−"}${AXES[axis]}${camera}`;
  };
  return svg.svg({ viewBox: "-118 -118 236 236", class: "space", "aria-hidden": "true" },
    svg.rect({ class: "field", x: -100, y: -100, width: 200, height: 200 }),
    svg.path({ class: "axes", d: "M-100 0h200M0 -100v200" }),
    svg.rect({ class: "goal", x: -at(goal), y: -at(goal), width: 2 * at(goal), height: 2 * at(goal) }),
    centers.map((center, n) => svg.circle({ class: n === centers.length - 1 ? "ball newest" : "ball", cx: at(center[across]), cy: -at(center[up]), r: 5 })),
    svg.text({ x: 100, y: 114, "text-anchor": "end" }, label(across, 1)),
    svg.text({ x: -100, y: 114 }, label(across, -1)),
    svg.text({ x: 0, y: -104, "text-anchor": "middle" }, label(up, 1)),
    svg.text({ x: 0, y: 114, "text-anchor": "middle" }, label(up, -1)),
  );
}

/** Draw where in each image a ball was seen whole. */
export function cameraCoverage(drops, { cameras: seen, goals }, rig, diameter_mm) {
  const tile = (camera) => {
    const [width, height] = camera.image_size_px;
    const coverage = seen[camera.id] ?? { n_drops: 0, field_share: 0 };
    const circles = drops
      .filter(({ center_mm: center, views }) => center !== null && views.includes(camera.id))
      .map((drop) => {
        const { u, v, px_per_mm: scale } = project(camera, drop.center_mm);
        return svg.circle({ class: "ball", cx: u, cy: v, r: ((drop.diameter_mm ?? diameter_mm) / 2) * scale });
      });
    const isEnough = coverage.n_drops >= goals.n_drops_per_camera;
    return html.figure({ class: isEnough ? "view enough" : "view" },
      svg.svg({ viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" }, svg.rect({ class: "field", width, height }), circles),
      html.figcaption(html.strong(camera.id), ` ${isEnough ? "✓" : ""} ${word("setup.view-words", { n: coverage.n_drops, share: number(100 * coverage.field_share) })}`),
    );
  };
  return [html.h3(word("setup.views")), html.div({ class: "views" }, rig.layers.flat().map(tile))];
}

/** List the drops, the newest first, with what was left out and why. */
export function dropList(drops) {
  const told = ({ views, refused }) =>
    [word("setup.drop-views", { n: views.length }), ...Object.entries(refused).map(([camera, code]) => `${camera}: ${wordOr(`setup.refused-${code}`, code)}`)].join("; ");
  const item = (drop) => html.li(html.span(quantity(drop.diameter_mm, 2, "mm")), " ", drop.problem === null ? told(drop) : quoted(drop.problem));
  if (drops.length === 0) return html.p({ class: "weak" }, word("setup.no-drops"));
  return [html.h3(word("setup.drops")), html.ol({ class: "drops", reversed: true }, drops.map(item).reverse())];
}
