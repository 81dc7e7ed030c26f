/** The operator's page: one stream of the rig's state, and what each part of the page makes of it. */

import { byId } from "./dom.js";
import { holdPaint, showBanner, showOrigin, startPage } from "./header.js";
import { follow } from "./live.js";
import { showAlarms } from "./operator/alarms.js";
import { showCameras } from "./operator/cameras.js";
import { showCurve } from "./operator/curve.js";
import { showFacts } from "./operator/facts.js";
import { showLot, showState } from "./operator/state.js";
import { showStones } from "./operator/stones.js";
import { mountTrends, showTiles } from "./operator/trends.js";
import { showHistory, showVerdict } from "./operator/verdict.js";
import { time, word } from "./words.js";

const PARTS = [showOrigin, showState, showLot, showVerdict, showHistory, showCurve, showTiles, showAlarms, showStones, showCameras, showFacts];

await startPage();
mountTrends();
holdPaint(new Promise((shown) => follow({
  onOverview(overview) {
    PARTS.forEach((show) => show(overview));
    byId("main").dataset.known = "";
    shown();
  },
  onSilence(since) {
    document.body.classList.toggle("stale", since !== null);
    showBanner("connection", since && word("operator.no-connection", { since: time(since) }));
  },
})));
