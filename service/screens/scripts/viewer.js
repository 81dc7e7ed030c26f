/** A stone's body in 3-D: turned by mouse, touch and keys, with the gauges that measured it; a picture where there is no 3-D. */

import { gauges } from "./calipers.js";
import { html, show } from "./dom.js";
import { number, word } from "./words.js";

/** The direction that previews are seen from, in the rig's frame. */
const SEEN_FROM = [0.55, -0.7, 0.45];
const STONE_RGB = [0.8, 0.75, 0.68];
const LIGHTS = [[-0.55, 0.65, 0.52, 2.0], [0.8, 0.1, 0.59, 0.75]];
const MM_PER_M = 1000;
const ROOM = 1.5; // for what lies beside the body: beams, and corners of the sieve
const BAR_LENGTHS_MM = [50, 20, 10, 5, 2, 1];
const KEYS_TURN = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const TURN_OF_A_KEY = Math.PI / 18;

/**
 * Show the body of a stone in `place` and return it, or null where a picture had to do; `stone` has its name, its
 * result, the addresses of a small mesh and of a picture, and a promise of what `/particles/{id}/calipers` returns.
 */
export async function showBody(place, stone) {
  let why = "viewer.no-package";
  try {
    const modules = await modulesFor3d();
    if (modules !== null) {
      why = "viewer.no-webgl";
      if (document.createElement("canvas").getContext("webgl2") !== null) return await new Body(place, stone, modules).load();
    }
  } catch (error) {
    console.warn(error); // the picture says the same to people
    why = "viewer.failed";
  }
  showPicture(place, stone, why);
  return null;
}

function showPicture(place, { preview, name }, why) {
  show(place, html.img({ class: "body-picture", src: preview, alt: name }), html.p({ class: "note" }, word(why)));
}

/** Return what draws bodies; null where the installation has no packages. */
async function modulesFor3d() {
  const installed = await fetch(new URL("../packages.json", import.meta.url)).then((response) => response.json());
  if (!installed.includes("three")) return null;
  const [three, orbit, gltf] = await Promise.all(
    ["three.module", "OrbitControls", "GLTFLoader"].map((name) => import(`../packages/three/${name}.js`)));
  return { three, OrbitControls: orbit.OrbitControls, GLTFLoader: gltf.GLTFLoader };
}

/** A body on a canvas, drawn when something has changed and at no other time. */
class Body {
  constructor(place, stone, { three, OrbitControls, GLTFLoader }) {
    Object.assign(this, { place, stone, three, GLTFLoader });
    this.canvas = html.canvas({
      class: "body", tabindex: 0, role: "application", "aria-label": word("viewer.label", { name: stone.name }), "aria-describedby": "viewer-help",
    });
    this.labels = html.div({ class: "gauge-labels", "aria-hidden": "true" });
    this.bar = html.div({ class: "scale-bar", "aria-hidden": "true" });
    this.renderer = new three.WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.camera = new three.OrthographicCamera();
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.canvas);
    Object.assign(this.controls, { enablePan: false, minZoom: 0.5, maxZoom: 12 });
    this.scene = new three.Scene();
    this.gauges = new Map();
    this.isAsked = false;
  }

  async load() {
    const [geometry, calipers] = await Promise.all([this.geometryAt(this.stone.mesh), this.stone.calipers]);
    const isTextured = geometry.hasAttribute("color");
    const material = new this.three.MeshLambertMaterial({ vertexColors: isTextured });
    if (!isTextured) material.color.setRGB(...STONE_RGB, this.three.SRGBColorSpace);
    this.model = new this.three.Mesh(geometry, material);
    this.scene.add(this.model, this.camera);
    this.light();
    show(this.place, this.canvas, this.labels, this.bar, html.p({ id: "viewer-help", class: "note" }, word("viewer.help")));
    if (calipers !== null) {
      this.gauges = gauges(this.three, calipers, geometry.attributes.position.array, (name) => this.colour(name));
      for (const [name, gauge] of this.gauges) this.addGauge(name, gauge);
    }
    this.lookAt(geometry.boundingSphere);
    this.listen();
    this.fit();
    return this;
  }

  /** Return the body in a GLB file, in mm with z up. */
  async geometryAt(address) {
    const response = await fetch(address);
    if (!response.ok) throw new Error(`${address}: ${response.status}`);
    const { scene } = await new this.GLTFLoader().parseAsync(await response.arrayBuffer(), "");
    const { geometry, matrixWorld } = scene.getObjectByProperty("isMesh", true);
    geometry.applyMatrix4(matrixWorld); // as the file places it; then from metres with y up to mm with z up
    geometry.scale(MM_PER_M, MM_PER_M, MM_PER_M).rotateX(Math.PI / 2);
    geometry.computeVertexNormals();
    geometry.computeBoundingSphere();
    return geometry;
  }

  /** Show the mesh at this address in the place of the one that is shown; gauges and view stay. */
  async refine(address) {
    const geometry = await this.geometryAt(address);
    this.model.geometry.dispose();
    this.model.geometry = geometry;
    this.ask();
  }

  /** Show or hide one gauge. */
  toggle(name, isShown) {
    const gauge = this.gauges.get(name);
    gauge.object.visible = isShown;
    gauge.text.hidden = !isShown;
    this.ask();
  }

  dispose() {
    this.listening.abort();
    this.sizes.disconnect();
    this.themes.disconnect();
    this.controls.dispose();
    for (const gauge of this.gauges.values()) gauge.dispose();
    this.model.geometry.dispose();
    this.model.material.dispose();
    this.renderer.dispose();
  }

  addGauge(name, gauge) {
    const valueMm = this.stone.result[name === "sieve" ? "sieve_size_mm" : `${name}_mm`]; // what was measured is said
    gauge.text = html.span({ class: `gauge ${name}` }, `${word(`viewer.gauge-${name}`)} ${number(valueMm, 2)} mm`);
    this.labels.append(gauge.text);
    this.scene.add(gauge.object);
  }

  /** Return the colour of a gauge in the theme of the moment, as it comes out of the styles. */
  colour(name) {
    const probe = html.span({ class: `gauge ${name}` });
    this.labels.append(probe);
    const { color } = getComputedStyle(probe);
    probe.remove();
    return color;
  }

  light() {
    this.camera.add(new this.three.AmbientLight(0xffffff, 0.5));
    for (const [x, y, z, intensity] of LIGHTS) {
      const light = new this.three.DirectionalLight(0xffffff, intensity);
      light.position.set(x, y, z);
      light.target = this.model;
      this.camera.add(light); // it goes with who looks, as if the stone were turned in the hand
    }
  }

  lookAt({ center, radius }) {
    this.radius = radius;
    this.camera.position.set(...SEEN_FROM).setLength(10 * radius).add(center);
    Object.assign(this.camera, { near: 0.1 * radius, far: 20 * radius });
    this.controls.target.copy(center);
    this.controls.update();
    this.controls.saveState();
  }

  listen() {
    this.listening = new AbortController();
    const { signal } = this.listening;
    this.controls.addEventListener("change", () => this.ask());
    this.canvas.addEventListener("keydown", (event) => this.turnByKey(event), { signal });
    this.canvas.addEventListener("webglcontextlost", () => {
      this.dispose();
      showPicture(this.place, this.stone, "viewer.failed");
    }, { signal });
    this.sizes = new ResizeObserver(() => this.fit());
    this.sizes.observe(this.canvas);
    this.themes = new MutationObserver(() => this.paint());
    this.themes.observe(document.documentElement, { attributeFilter: ["data-theme"] });
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.paint(), { signal });
  }

  turnByKey(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const { key } = event;
    if (key in KEYS_TURN) {
      const [right, down] = KEYS_TURN[key];
      this.controls.rotateLeft(-right * TURN_OF_A_KEY);
      this.controls.rotateUp(-down * TURN_OF_A_KEY);
    } else if (key === "+" || key === "=") this.controls.dollyIn(0.87);
    else if (key === "-") this.controls.dollyOut(0.87);
    else if (key === "0" || key === "Home") this.controls.reset();
    else return;
    event.preventDefault();
    this.ask();
  }

  fit() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return; // hidden
    const half = (ROOM * this.radius) / Math.min(width, height);
    Object.assign(this.camera, { left: -half * width, right: half * width, top: half * height, bottom: -half * height });
    this.pxPerMm = 1 / (2 * half);
    this.renderer.setSize(width, height, false);
    this.ask();
  }

  paint() {
    for (const [name, gauge] of this.gauges) gauge.paint(this.colour(name));
    this.ask();
  }

  /** Draw with the next frame; a page that is hidden has none. */
  ask() {
    if (this.isAsked) return;
    this.isAsked = true;
    requestAnimationFrame(() => {
      this.isAsked = false;
      this.draw();
    });
  }

  draw() {
    this.camera.updateProjectionMatrix();
    this.renderer.render(this.scene, this.camera);
    const { clientWidth: width, clientHeight: height } = this.canvas;
    for (const gauge of this.gauges.values()) {
      const { x, y } = gauge.label.clone().project(this.camera);
      gauge.text.style.translate = `${((x + 1) / 2) * width}px ${((1 - y) / 2) * height}px`;
    }
    const pxPerMm = this.pxPerMm * this.camera.zoom;
    const lengthMm = BAR_LENGTHS_MM.find((each) => each * pxPerMm < width / 3) ?? BAR_LENGTHS_MM.at(-1);
    this.bar.style.width = `${lengthMm * pxPerMm}px`;
    this.bar.textContent = `${number(lengthMm)} mm`;
  }
}
