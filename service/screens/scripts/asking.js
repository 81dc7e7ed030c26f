/** Asking again: while an element is there, when the rig has changed, and for what a person chose last. */

import { Problem, Unreachable } from "./api.js";

/**
 * Call `ask` now and again so many seconds after each answer, for as long as `place` is on the page; return a function
 * that asks at once. What fails is asked again: the daemon may be starting anew.
 */
export function poll(place, seconds, ask) {
  let timer, isAsking = false;
  async function again() {
    clearTimeout(timer);
    if (isAsking) return;
    isAsking = true;
    await ask().catch(reportFault);
    isAsking = false;
    if (place.isConnected) timer = setTimeout(again, 1000 * seconds);
  }
  again();
  return again;
}

/**
 * Return a function that calls `ask` with a state that is another than the one answered last: one at a time, and what
 * fails is asked again with the next state. Its `again` asks at once.
 */
export function askWhenNew(ask) {
  let latest = null, answered = null, isAsking = false;
  async function see(state) {
    latest = state;
    const text = JSON.stringify(state);
    if (text === answered || isAsking) return;
    isAsking = true;
    await ask(state).then(() => (answered = text), reportFault);
    isAsking = false;
  }
  see.again = async () => {
    answered = null;
    if (latest !== null) await see(latest);
  };
  return see;
}

/** Return a function that passes answers on, but none that comes after a later question was put: it never arrives. */
export function latestOnly() {
  let latest = null;
  return (answer) => {
    latest = answer;
    return new Promise((resolve, reject) => {
      Promise.resolve(answer).then((value) => latest === answer && resolve(value), (error) => latest === answer && reject(error));
    });
  };
}

/** A refusal, or no answer, is what others tell of. */
function reportFault(error) {
  if (!(error instanceof Problem || error instanceof Unreachable)) reportError(error);
}
