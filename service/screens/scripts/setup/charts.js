/** The drawings of a verification. Every figure that they show also stands in words beside them. */

import { html, svg } from "../dom.js";
import { number, quantity, word } from "../words.js";

/** Draw a figure in mm on a scale between its limits, either way. */
export function gauge(name, value, limit, isOneSided) {
  const end = 1.6 * limit;
  const at = (x) => (isOneSided ? 10 + (180 * Math.min(x, end)) / end : 100 + (90 * Math.max(-end, Math.min(x, end))) / end);
  const isWithin = value !== null && Math.abs(value) <= limit;
  return html.div({ class: "gauge" },
    html.span({ class: "weak" }, name),
    html.strong(quantity(value, 3, "mm")),
    svg.svg({ viewBox: "0 0 200 26", "aria-hidden": "true" },
      svg.rect({ class: "within", x: at(isOneSided ? 0 : -limit), y: 9, width: at(limit) - at(isOneSided ? 0 : -limit), height: 8 }),
      svg.line({ class: "scale", x1: 10, x2: 190, y1: 13, y2: 13 }),
      value !== null && svg.path({ class: isWithin ? "hand" : "hand beyond", d: `M${at(value)} 3l6 -3h-12zM${at(value)} 3v20` }),
    ),
    html.span(word(value === null ? "setup.no-figure" : isWithin ? "setup.within" : "setup.beyond", { limit: number(limit, 2), unit: "mm" })),
  );
}

/** Draw the control chart of the verifications. */
export function controlChart({ points, lower_mm: lower, upper_mm: upper, diameter_mm: diameter }, limit) {
  const [width, height, left] = [640, 200, 64];
  const reach = 1.15 * Math.max(limit, upper ?? 0, ...points.map(({ error_mm: error }) => Math.abs(error)));
  const y = (mm) => height / 2 - (mm / reach) * (height / 2 - 12);
  const x = (n) => left + 20 + (points.length === 1 ? 0 : (n * (width - left - 40)) / (points.length - 1));
  const rule = (mm, kind) => [
    svg.line({ class: kind, x1: left, x2: width, y1: y(mm), y2: y(mm) }),
    svg.text({ x: left - 6, y: y(mm) + 4, "text-anchor": "end" }, number(mm, 2)),
  ];
  const isOut = (point) => point.is_beyond_limits || point.is_shifted || point.state === "failed";
  const mark = (point, n) =>
    isOut(point)
      ? svg.path({ class: "out", d: `M${x(n)} ${y(point.error_mm) - 7}l7 12h-14z` })
      : svg.circle({ class: "in", cx: x(n), cy: y(point.error_mm), r: 4.5 });
  return svg.svg({ viewBox: `0 0 ${width} ${height}`, class: "chart", role: "img", "aria-label": word("setup.chart-words", { n: points.length, out: points.filter(isOut).length, diameter: number(diameter, 1) }) },
    rule(0, "center"),
    rule(limit, "limit"),
    rule(-limit, "limit"),
    upper !== null && [rule(upper, "control"), rule(lower, "control")],
    svg.polyline({ class: "line", points: points.map(({ error_mm: error }, n) => `${x(n)},${y(error)}`).join(" ") }),
    points.map(mark),
  );
}
