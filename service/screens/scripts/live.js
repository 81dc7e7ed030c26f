/** The state of the rig as it changes, and whether this page still hears of it. */

import { BASE, get } from "./api.js";

const EVENT = "overview";
const MAX_SILENCE_MS = 10_000;
const PROBE_TIMEOUT_MS = 5000;
const RETRY_MS = 3000;

/**
 * Call `onOverview` with each overview, for as long as the page is there, and `onSilence` with the time since when
 * nothing is heard, then with null once something is heard again.
 */
export function follow({ onOverview, onSilence }) {
  let source, heardAt = new Date(), isSilent = false;

  function heard() {
    heardAt = new Date();
    if (isSilent) {
      isSilent = false;
      onSilence(null);
      reloadIfNewer().catch(() => {});
    }
  }

  function connect() {
    source?.close();
    source = new EventSource(`${BASE}/overview/stream`);
    source.addEventListener("open", heard);
    source.addEventListener(EVENT, (event) => {
      heard();
      onOverview(JSON.parse(event.data));
    });
    source.addEventListener("error", () => {
      // the browser tries again by itself but after a refusal, and does not tell which one it was
      if (source.readyState === EventSource.CLOSED) {
        get("/overview").catch(() => {}).finally(() => setTimeout(connect, RETRY_MS));
      }
    });
  }

  /** An idle rig is silent as well: ask whether anybody is there before saying that nobody is. */
  async function probe() {
    if (Date.now() - heardAt < MAX_SILENCE_MS) return;
    try {
      const answer = await fetch(`${BASE}/health/live`, { signal: AbortSignal.timeout(PROBE_TIMEOUT_MS), cache: "no-store" });
      if (!answer.ok) throw new Error(answer.statusText);
      if (source.readyState === EventSource.OPEN && !isSilent) heardAt = new Date();
      else if (isSilent) connect(); // the old connection may be dead without knowing
    } catch {
      if (!isSilent) onSilence(heardAt);
      isSilent = true;
    }
  }

  connect();
  setInterval(probe, MAX_SILENCE_MS / 4);
}

/** Load the page again after an upgrade: its address of this very file is then another one. */
async function reloadIfNewer() {
  const page = await (await fetch(location.pathname, { cache: "no-cache" })).text();
  const version = new URL(import.meta.url).pathname.split("/").at(-3);
  if (!page.includes(version)) location.reload();
}
