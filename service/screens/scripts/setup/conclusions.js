/** What follows from who blinked where: the camera in each place, what contradicts, the section of the configuration. */

/**
 * @param {Record<string, {place?: string, serial?: string, problem?: string, cause?: string}>} seen by camera
 * @returns {{rows: {place: string, found: object[]}[], findings: {code: string, values: object, detail?: string}[]}}
 */
export function conclude(seen, { cameras: places }, cameras, configured) {
  const sorted = places.map(({ id }) => id).sort();
  const rows = sorted.map((place) => ({
    place,
    found: Object.entries(seen).filter(([, each]) => each.place === place).map(([camera, each]) => ({ camera, ...each })),
  }));
  const findings = [];
  const add = (code, values, detail) => findings.push({ code, values, detail });
  const told = (camera) => configured.find(({ id }) => id === camera)?.serial ?? "–";
  for (const { id } of cameras) {
    const each = seen[id];
    if (each === undefined) add("not-asked", { camera: id });
    else if (each.cause === "unseen") add("unseen", { camera: id, serial: each.serial });
    else if (each.cause === "silent") add("silent", { camera: id, serial: told(id) }, each.problem);
    else if (each.cause === "wrong_camera") add("wrong-serial", { camera: id, serial: told(id) }, each.problem);
    else if (each.problem !== undefined) add("trouble", { camera: id }, each.problem);
  }
  for (const { place, found } of rows) {
    if (found.length > 1) add("two", { place, cameras: found.map(({ camera, serial }) => serial ?? camera).join(", ") });
    for (const { camera, serial } of found) {
      const there = seen[place]?.place;
      if (camera === place) continue;
      if (there !== camera) add("elsewhere", { camera, place, serial: serial ?? "–" });
      else if (camera < place) add("exchanged", { a: camera, b: place });
    }
  }
  for (const { id, serial } of places) {
    const found = rows.find(({ place }) => place === id).found;
    if (found.length === 1 && serial && found[0].serial && found[0].serial !== serial) {
      add("calibrated-other", { place: id, serial: found[0].serial, before: serial });
    }
  }
  return { rows, findings };
}

/** Return the cameras of `[rig]` as the configuration should have them; an address goes with its camera. */
export function snippet(rows, configured) {
  const section = ({ place, found }) => {
    if (found.length !== 1) return `# ${place}: ${found.length === 0 ? "no camera was seen here" : "more than one camera was seen here"}`;
    const [{ camera, serial }] = found;
    const { address, user_name: userName } = configured.find(({ id }) => id === camera) ?? {};
    const lines = [["id", place], ["serial", serial], ["address", address], ["user_name", userName]];
    return ["[[rig.cameras]]", ...lines.filter(([, value]) => value).map(([key, value]) => `${key} = ${JSON.stringify(value)}`)].join("\n");
  };
  return `${rows.map(section).join("\n\n")}\n`;
}
