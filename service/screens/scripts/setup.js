/** The page that sets the rig up: four wizards, webhooks and screens, of which the address names one. */

import { byId, html, show } from "./dom.js";
import { startPage, titled } from "./header.js";
import { mountCalibration } from "./setup/calibration.js";
import { mountPlaces } from "./setup/places.js";
import { mountRecording } from "./setup/recording.js";
import { mountScreens } from "./setup/screens.js";
import { mountVerification } from "./setup/verification.js";
import { mountWebhooks } from "./setup/webhooks.js";
import { word } from "./words.js";

const WIZARDS = { places: mountPlaces, calibration: mountCalibration, verification: mountVerification, recording: mountRecording, webhooks: mountWebhooks, screens: mountScreens };

await startPage();
window.addEventListener("hashchange", enter);
enter();

/** Show the wizard that the address names. */
function enter() {
  const asked = location.hash.slice(1);
  const chosen = asked in WIZARDS ? asked : "calibration";
  titled(word(`setup.wizard-${chosen}`));
  const link = (name) =>
    html.a({ href: `#${name}`, "aria-current": name === chosen && "page" }, word(`setup.wizard-${name}`), html.small(word(`setup.wizard-for-${name}`)));
  show(byId("wizards"), Object.keys(WIZARDS).map(link));
  const place = html.section({ class: "wizard", "aria-label": word(`setup.wizard-${chosen}`) });
  show(byId("wizard"), place);
  WIZARDS[chosen](place);
}
