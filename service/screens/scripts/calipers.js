/** The gauges that a stone was measured with, drawn where they touch it; lengths in mm, z up. */

/** To which side of the body the beam of each caliper lies, so that they do not meet: an axis and its sign. */
const SIDES = { length: ["width", 1], width: ["thickness", 1], thickness: ["width", -1], max_feret: ["thickness", -1], min_feret: ["length", 1] };
const GAP = 0.12;
const BAR_RADIUS = 0.009;
const TOUCH_RADIUS = 0.032;

/**
 * Return the gauges as objects of `three` by name, each with the place of its label; `document` is what
 * `/particles/{id}/calipers` returned, `vertices` has three numbers for each of the body's, `colour` returns that of a gauge.
 */
export function gauges(three, document, vertices, colour) {
  const size = document.length.value_mm / 2;
  const drawn = new Map();
  for (const name of Object.keys(SIDES)) {
    if (document[name]) drawn.set(name, new Gauge(three, size, colour(name)).caliper(document, name, vertices));
  }
  if (document.sieve) drawn.set("sieve", new Gauge(three, size, colour("sieve")).square(document.sieve));
  return drawn;
}

/** One gauge: solid where it is before the body, faint where the body hides it. */
class Gauge {
  constructor(three, size, colour) {
    this.three = three;
    this.size = size;
    this.solid = new three.MeshBasicMaterial({ color: colour });
    this.hidden = new three.MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.28, depthTest: false, depthWrite: false });
    this.object = new three.Group();
    this.label = new three.Vector3();
  }

  paint(colour) {
    for (const child of this.object.children) child.material.color.set(colour);
  }

  dispose() {
    for (const child of this.object.children) {
      child.geometry.dispose();
      child.material.dispose();
    }
  }

  /** Draw two jaws from where they touch to the beam between them, which runs beside the body. */
  caliper(document, name, vertices) {
    const { a_mm: aMm, b_mm: bMm, direction } = document[name];
    const [a, b, along] = [aMm, bMm, direction].map((place) => new this.three.Vector3(...place));
    const [axis, sign] = SIDES[name];
    const aside = new this.three.Vector3(...document[axis].direction).multiplyScalar(sign);
    aside.addScaledVector(along, -aside.dot(along)).normalize();
    const reach = furthest(vertices, aside) + GAP * this.size;
    const ends = [a, b].map((touch) => touch.clone().addScaledVector(aside, reach - touch.dot(aside)));
    // the beam runs along the direction, wherever on its plane each jaw touches
    const line = ends[0].clone().add(ends[1]).multiplyScalar(0.5);
    for (const end of ends) end.copy(line.clone().addScaledVector(along, end.clone().sub(line).dot(along)));
    [a, b].forEach((touch, i) => {
      this.bar(touch, ends[i]);
      this.dot(touch);
    });
    this.bar(...ends);
    this.label.copy(line);
    return this;
  }

  /** Draw the smallest square that the body passes, and from each place that touches it the way to its edge. */
  square({ corners_mm: cornersMm, touches_mm: touchesMm, direction }) {
    const corners = cornersMm.map((corner) => new this.three.Vector3(...corner));
    const along = new this.three.Vector3(...direction);
    corners.forEach((corner, i) => this.bar(corner, corners[(i + 1) % corners.length]));
    for (const touchMm of touchesMm) {
      const touch = new this.three.Vector3(...touchMm);
      this.dot(touch);
      this.bar(touch, touch.clone().addScaledVector(along, corners[0].dot(along) - touch.dot(along)), 0.5);
    }
    const pane = new this.three.BufferGeometry().setFromPoints([0, 1, 2, 0, 2, 3].map((i) => corners[i]));
    const glass = this.hidden.clone();
    Object.assign(glass, { opacity: 0.12, depthTest: true, side: this.three.DoubleSide });
    this.object.add(new this.three.Mesh(pane, glass));
    this.label.copy(corners[0]).lerp(corners[1], 0.5);
    return this;
  }

  bar(from, to, thickness = 1) {
    const length = from.distanceTo(to);
    if (length === 0) return;
    const radius = BAR_RADIUS * thickness * this.size;
    const geometry = new this.three.CylinderGeometry(radius, radius, length, 8);
    const place = (mesh) => {
      mesh.position.copy(from).lerp(to, 0.5);
      mesh.quaternion.setFromUnitVectors(new this.three.Vector3(0, 1, 0), to.clone().sub(from).normalize());
    };
    this.add(geometry, place);
  }

  dot(at) {
    this.add(new this.three.SphereGeometry(TOUCH_RADIUS * this.size, 16, 12), (mesh) => mesh.position.copy(at));
  }

  add(geometry, place) {
    for (const material of [this.hidden, this.solid]) {
      const mesh = new this.three.Mesh(geometry, material);
      place(mesh);
      this.object.add(mesh);
    }
  }
}

/** Return the greatest coordinate along a direction. */
function furthest(vertices, { x, y, z }) {
  let greatest = -Infinity;
  for (let i = 0; i < vertices.length; i += 3) {
    greatest = Math.max(greatest, x * vertices[i] + y * vertices[i + 1] + z * vertices[i + 2]);
  }
  return greatest;
}
