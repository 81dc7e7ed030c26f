/** Asking again and again while a wizard is open. */

import { Problem, Unreachable } from "../api.js";

let generation = 0;

/** End all polling: another wizard is shown. */
export const stopPolling = () => {
  generation += 1;
};

/**
 * Call `ask` now and again so many seconds after each answer, for as long as this wizard is open; return a function
 * that asks at once. What fails is asked again: the daemon may be starting anew.
 */
export function poll(seconds, ask) {
  const mine = generation;
  let timer, isAsking = false;
  async function again() {
    clearTimeout(timer);
    if (mine !== generation || isAsking) return;
    isAsking = true;
    try {
      await ask(() => mine === generation);
    } catch (error) {
      if (!(error instanceof Problem || error instanceof Unreachable)) reportError(error);
    } finally {
      isAsking = false;
    }
    timer = setTimeout(again, 1000 * seconds);
  }
  again();
  return again;
}
