"""What is served keeps to `deploy/openapi.json`: schemathesis asks for all of it, with examples that it makes up."""

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.outcomes import add, measured, rejected, result
from support.rest import FakeControl, app_of, particle_files
from support.served import served_by

from service.base.status import CheckStatus, HealthCheck
from service.daemon.rest.openapi import openapi_text
from service.health.alarms.alarms import Alarms
from service.lots.lots import LotDefinition, close_lot, open_lot
from service.lots.products import ProductDefinition, save_product
from service.store import Store
from service.web import pace
from service.web.openapi_parts import shared_answer
from service.web.problems import all_problems
from service.web.version import BASE

CHECKS = (
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_headers_conformance",
    "response_schema_conformance",
)
EXAMPLES = {"examples": 1, "examples,fuzzing": 4, "examples,coverage,fuzzing": 6}
"""Made-up requests of each operation, beside the examples of the document, by the phases of a run."""
NAMES = """
[parameters]
"path.particle_id" = "1"
"path.camera" = "c01"
"path.product" = "basalt-8-16"
"path.lot" = "L2"
"path.calibration" = "0001"
"path.alarm" = 1
"path.webhook" = "mes"
"""
"""What there is, so that requests find it: the configuration of schemathesis."""


STREAMED = {
    f"{BASE}/results/stream": "Result",
    f"{BASE}/events/stream": "EventDocument",
    f"{BASE}/overview/stream": "OverviewDocument",
}
"""Schema of the items of a stream, which OpenAPI 3.1 has no word for."""


def event_of(schema: str) -> dict[str, Any]:
    """Return the schema of a server-sent event in the manner of schemathesis: the first, or an item."""
    item = {
        "contentMediaType": "application/json",
        "contentSchema": {"$ref": f"#/components/schemas/{schema}"},
    }
    if schema == "OverviewDocument":
        return {"type": "object", "properties": {"event": {"const": "overview"}, "data": item}}
    return {
        "type": "object",
        "if": {"properties": {"event": {"const": "history"}}},
        "then": {"properties": {"id": False}},
        "else": {"properties": {"data": item}, "required": ["id"]},
    }


def strict_document(base_url: str) -> str:
    """Return the document as it is served at `base_url`, with all that it describes of an answer required.

    A problem must be named with its status, not as any other, and have a type of this status.
    """
    document = json.loads(openapi_text())
    document["servers"] = [{"url": base_url}]
    for path, schema in STREAMED.items():
        content = document["paths"][path]["get"]["responses"]["200"]["content"]
        content["text/event-stream"]["schema"] = event_of(schema)
    for operations in document["paths"].values():
        for operation in operations.values():
            operation["responses"].pop("default", None)
            # it would take most POSTs for repetitions of another one
            operation["parameters"] = [
                each
                for each in operation.get("parameters", [])
                if each != {"$ref": "#/components/parameters/Idempotency-Key"}
            ]
    components = document["components"]
    for status, titles in all_problems().items():
        answer = components["responses"][shared_answer(str(int(status)))["$ref"].split("/")[-1]]
        types = {"properties": {"type": {"enum": [f"urn:stonefall:problem:{slug}" for slug in titles]}}}
        content = answer["content"]["application/problem+json"]
        content["schema"] = {"allOf": [content["schema"], types]}
        if status in (409, 412):  # some problems of this status have it
            del answer["headers"]
    for name in ("ETag", "Location", "Retry-After"):
        components["headers"][name]["required"] = True
    return json.dumps(document)


async def fill(store: Store, session: int, folder: Path) -> None:
    """Store a product with two lots, and stones of each outcome, the first with its files."""
    definition = ProductDefinition(title="8/16", density_kg_m3=2700.0, lower_mm=8.0, upper_mm=16.0)
    await store.write(save_product, "basalt-8-16", definition, "test")
    await store.write(open_lot, LotDefinition(lot="L1"), "basalt-8-16", None, "test")
    files = await asyncio.to_thread(particle_files, folder)
    lengths = dict.fromkeys(("sieve_size_mm", "min_feret_mm", "length_mm", "width_mm", "thickness_mm"), 10.0)
    others = {"max_feret_mm": 15.0, "volume_mm3": 600.0, "volume_sd_percent": 0.5, "surface_sd_mm": 0.02}
    await add(store, session, 1, measured(**lengths, **others), files)
    await add(store, session, 2, rejected("empty"))
    await add(store, session, 3, result(outcome="lost", reason="queue_full"))
    await store.write(close_lot, "L1", None, "test")
    await store.write(open_lot, LotDefinition(lot="L2"), "basalt-8-16", None, "test")


@pytest.mark.usefixtures("webhooks", "again")
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "phases",
    [
        "examples",
        pytest.param("examples,fuzzing", marks=pytest.mark.full),
        pytest.param("examples,coverage,fuzzing", marks=pytest.mark.night),
    ],
)
async def test_schemathesis_finds_nothing(
    phases: str,
    store: Store,
    session: int,
    control: FakeControl,
    alarms: Alarms,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    await fill(store, session, tmp_path / "out")
    alarms.update({"trigger_line": HealthCheck(status=CheckStatus.FAIL)})  # an alarm at once
    control.images["c01"] = np.zeros((6, 8), np.uint8)
    store.release_waiters()  # no long poll waits, and streams end
    monkeypatch.setattr(pace, "RATE_HZ", 1e6)
    document = tmp_path / "openapi.json"
    config = tmp_path / "schemathesis.toml"
    config.write_text(NAMES, encoding="utf-8")
    async with served_by(app_of(store, control)) as served:
        address = f"http://127.0.0.1:{served.port}"
        document.write_text(strict_document(address), encoding="utf-8")
        asking = await asyncio.create_subprocess_exec(
            *(
                sys.executable,
                "-m",
                "schemathesis.cli",
                "--config-file",
                str(config),
                "run",
                str(document),
                "--url",
                address,
            ),
            *("--checks", ",".join(CHECKS), "--phases", phases),
            *("--max-examples", str(EXAMPLES[phases]), "--generation-deterministic", "--no-color"),
            cwd=tmp_path,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
        )
        printed, _ = await asking.communicate()
    await control.recordings.close()  # one may have been begun
    assert asking.returncode == 0, printed.decode()
