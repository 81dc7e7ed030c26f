// Makes the calls of a client whose types openapi-typescript made; the argument is the daemon's address.
import { strict as assert } from "node:assert";
import createClient from "openapi-fetch";
import type { components, paths } from "./stonefall";

const client = createClient<paths>({ baseUrl: process.argv[2] });
const path = (name: string) => ({ path: { lot: name } });

/** Return the body of an answer that is no problem. */
function answered<T>(answer: { data?: T; error?: components["schemas"]["Problem"] }): T {
  assert.equal(answer.error, undefined);
  assert(answer.data !== undefined);
  return answer.data;
}

async function bytes(answer: Promise<{ data?: ArrayBuffer }>): Promise<string> {
  return Buffer.from((await answer).data ?? new ArrayBuffer()).toString("latin1");
}

async function main(): Promise<void> {
  const { items } = answered(await client.GET("/api/v1/results", { params: { query: { after: 0 } } }));
  assert.deepEqual(items.map((each) => each.outcome), ["measured", "rejected", "lost"]);
  const lean = answered(await client.GET("/api/v1/results", { params: { query: { fields: "lean" } } })).items[0];
  assert.equal(lean?.sieve_size_mm, 10.0);
  const one = { params: { path: { particle_id: "1" } } };
  assert.equal(answered(await client.GET("/api/v1/particles/{particle_id}", one)).id, lean?.id);
  const measured = { params: { query: { outcome: "measured" as const } } };
  assert.equal(answered(await client.GET("/api/v1/particles", measured)).items.length, 1);
  const ply = { params: { path: { particle_id: "1", mesh_format: "ply" as const } }, parseAs: "arrayBuffer" as const };
  assert((await bytes(client.GET("/api/v1/particles/{particle_id}/mesh.{mesh_format}", ply))).startsWith("ply"));
  const png = { ...one, parseAs: "arrayBuffer" as const };
  assert((await bytes(client.GET("/api/v1/particles/{particle_id}/preview.png", png))).startsWith("\x89PNG"));
  assert.equal(answered(await client.GET("/api/v1/health")).ready, true);
  const parked = { params: { path: { name: "mes" } }, body: { after: 2 } };
  assert.equal(answered(await client.PUT("/api/v1/consumers/{name}/cursor", parked)).unread, 1);

  const product = { title: "own sieves", density_kg_m3: 2850, sieve_set: [4, 8, 16] };
  const put = { params: { path: { product: "own" } }, body: product };
  assert.equal(answered(await client.PUT("/api/v1/products/{product}", put)).title, "own sieves");
  const close = { params: path("L2"), body: {} };
  assert.equal(answered(await client.POST("/api/v1/lots/{lot}/close", close)).state, "closed");
  const open = { params: { header: { "Idempotency-Key": "one" } }, body: { lot: "L3", product: "own" } };
  const opened = answered(await client.POST("/api/v1/lots", open));
  const again = await client.POST("/api/v1/lots", open);
  assert.deepEqual(answered(again), opened);
  assert.equal(again.response.headers.get("Idempotent-Replayed"), "true");
  const pdf = { params: { path: { lot: "L1", report_format: "pdf" as const } }, parseAs: "arrayBuffer" as const };
  assert((await bytes(client.GET("/api/v1/lots/{lot}/report.{report_format}", pdf))).startsWith("%PDF"));
  const { error } = await client.GET("/api/v1/lots/{lot}", { params: path("L9") });
  assert.equal(error?.type, "urn:stonefall:problem:unknown-lot");
  console.log("all calls were answered as described");
}

void main();
