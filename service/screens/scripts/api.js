/** Requests to the REST interface of this host. */

/** Path below which this host serves pages and interface, as the page came: `/`, or what a proxy has in front of it. */
export const ROOT = new URL("../../../", import.meta.url).pathname;
export const BASE = `${ROOT}api/v1`;

/** A refusal, with the fields of RFC 9457: `type`, `title`, `status`, `detail`, and those of its type. */
export class Problem extends Error {
  constructor(fields) {
    super(fields.detail ?? fields.title ?? String(fields.status));
    Object.assign(this, fields);
  }
}

/** There was no answer: the network, or the daemon, is not there now. */
export class Unreachable extends Error {}

/** Return the document at `path`, which begins with a slash. */
export const get = (path) => ask("GET", path).then(json);

/** Return the text at `path`, such as a drawing. */
export const getText = (path) => ask("GET", path).then((response) => response.text().catch(lost));

/** Post `body`; one that the network lost is sent again under the same key, and so done once. */
export function post(path, body = null) {
  const headers = { "Idempotency-Key": newKey() };
  const send = () => ask("POST", path, body, headers).then(json);
  return send().catch((error) => {
    if (error instanceof Problem) throw error;
    return send();
  });
}

/** Put `body` in the place of what is there. */
export const put = (path, body) => ask("PUT", path, body).then(json);

/** Delete what is at `path`. */
export const remove = (path) => ask("DELETE", path).then(json);

async function ask(method, path, body = null, headers = {}) {
  const hasBody = body !== null;
  const response = await fetch(BASE + path, {
    method,
    headers: { Accept: "application/json, image/svg+xml", ...(hasBody && { "Content-Type": "application/json" }), ...headers },
    body: hasBody ? JSON.stringify(body) : undefined,
  }).catch(lost);
  if (response.ok) return response;
  const fields = await response.json().catch(() => ({ title: response.statusText }));
  if (response.status === 401) window.dispatchEvent(new CustomEvent("sign-in-needed"));
  throw new Problem({ status: response.status, ...fields });
}

const json = (response) => (response.status === 204 ? null : response.json().catch(lost));

function lost(error) {
  throw new Unreachable(error.message);
}

/** Return a random key; `crypto.randomUUID` is missing on pages that come without TLS from another machine. */
const newKey = () => Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
