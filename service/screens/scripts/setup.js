/** The page that sets the rig up: four wizards, of which the address names one. */

import { byId, element, show } from "./dom.js";
import { mountHeader } from "./header.js";
import { mountCalibration } from "./setup/calibration.js";
import { mountPlaces } from "./setup/places.js";
import { stopPolling } from "./setup/polling.js";
import { mountRecording } from "./setup/recording.js";
import { mountVerification } from "./setup/verification.js";
import { loadWords, word } from "./words.js";

const WIZARDS = {
  places: mountPlaces,
  calibration: mountCalibration,
  verification: mountVerification,
  recording: mountRecording,
};

await loadWords();
mountHeader("/setup");
window.addEventListener("hashchange", enter);
enter();

/** Show the wizard that the address names. */
function enter() {
  const chosen = location.hash.slice(1) in WIZARDS ? location.hash.slice(1) : "calibration";
  document.title = `${word(`setup.wizard-${chosen}`)} - stonefall`;
  stopPolling();
  show(
    byId("wizards"),
    ...Object.keys(WIZARDS).map((name) =>
      element("a", { href: `#${name}`, "aria-current": name === chosen && "page" }, word(`setup.wizard-${name}`), element("small", {}, word(`setup.wizard-for-${name}`)))),
  );
  const place = element("section", { class: "wizard", "aria-label": word(`setup.wizard-${chosen}`) });
  show(byId("wizard"), place);
  WIZARDS[chosen](place);
}
