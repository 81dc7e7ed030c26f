/** Where the cameras of the rig are, and where in their images a point in space is. */

import { get } from "../api.js";

/**
 * The rig of the calibration in use: cameras from the top layer to the lowest, each layer counter-clockwise.
 * @returns {Promise<{cameras: object[], layers: object[][]}>}
 */
export async function rigInUse() {
  const { active } = await get("/calibrations");
  const { cameras } = await get(`/calibrations/${active.id}/rig.json`);
  const placed = cameras.map((camera) => ({ ...camera, ...place(camera) }));
  return { cameras: placed, layers: layered(placed) };
}

/** Return where a camera is, seen from the middle of the rig: -R^T t. */
function place({ R, t_mm: t }) {
  const center_mm = [0, 1, 2].map((axis) => -(R[0][axis] * t[0] + R[1][axis] * t[1] + R[2][axis] * t[2]));
  const [x, y, z] = center_mm;
  return { center_mm, azimuth_deg: (Math.atan2(y, x) * 180) / Math.PI, elevation_deg: (Math.atan2(z, Math.hypot(x, y)) * 180) / Math.PI };
}

/** Split cameras into layers at the greatest gaps of elevation: four of four in the rig as designed. */
function layered(cameras) {
  const byHeight = [...cameras].sort((a, b) => b.elevation_deg - a.elevation_deg);
  const layers = [[]];
  byHeight.forEach((camera, n) => {
    if (n > 0 && byHeight[n - 1].elevation_deg - camera.elevation_deg > 12) layers.push([]);
    layers.at(-1).push(camera);
  });
  const turn = (camera) => (camera.azimuth_deg + 370) % 360; // those at 0 degrees, built a little off, come first
  return layers.map((layer) => layer.sort((a, b) => turn(a) - turn(b)));
}

/** Return the pixel of a point in space, without the distortion of the lens, and the pixels of a mm there. */
export function project({ K, R, t_mm: t }, point_mm) {
  const [x, y, z] = [0, 1, 2].map((row) => R[row][0] * point_mm[0] + R[row][1] * point_mm[1] + R[row][2] * point_mm[2] + t[row]);
  return { u: (K[0][0] * x) / z + K[0][2], v: (K[1][1] * y) / z + K[1][2], px_per_mm: K[0][0] / z };
}

/** Return the camera whose place is nearest to a direction in the horizontal plane. */
export function cameraTowards(cameras, direction) {
  const along = ({ center_mm: [x, y, z] }) => (x * direction[0] + y * direction[1]) / Math.hypot(x, y, z);
  return cameras.reduce((best, camera) => (along(camera) > along(best) ? camera : best));
}
