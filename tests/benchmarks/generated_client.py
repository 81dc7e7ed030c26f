"""Generate a Python client from `deploy/openapi.json`, and make its calls on a served store.

The generator pins an older typer than we use, so it has an environment of its own:

    python3 -m venv /tmp/generator && /tmp/generator/bin/pip install openapi-python-client
    .venv/bin/python tests/benchmarks/generated_client.py /tmp/generator/bin/openapi-python-client
"""

import argparse
import asyncio
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from api.test_api_contract import fill
from support.calibration_desk import open_desk
from support.recordings import SOURCE
from support.rest import FakeControl, app_of
from support.served import served_by

from service.recording.recordings import RecordingsSettings, open_recordings
from service.store import open_store

DEPLOY = Path(__file__).parents[2] / "deploy"
CALLS = """
import sys
from stonefall_client import Client
from stonefall_client.api.lots import get_lot, list_lots, post_close, post_lot, report_file
from stonefall_client.api.particles import mesh_file, particle, particles, preview
from stonefall_client.api.results import results
from stonefall_client.models import CloseRequest, LotRequest, MeshFormat, Problem, ReportFormat, Result

client = Client(base_url=sys.argv[1])
page = results.sync(client=client, after=0)
assert [item.outcome for item in page.items] == ["measured", "rejected", "lost"]
lean = results.sync(client=client, fields="lean")
assert lean.items[0].sieve_size_mm == 10.0 and not lean.items[0].optics
assert isinstance(particle.sync("1", client=client), Result)
assert len(particles.sync(client=client, outcome="measured").items) == 1
assert mesh_file.sync("1", MeshFormat.PLY, client=client).payload.read().startswith(b"ply")
assert preview.sync("1", client=client).payload.read().startswith(b"\\x89PNG")
assert post_close.sync("L2", client=client, body=CloseRequest()).state == "closed"
opened = [
    post_lot.sync_detailed(
        client=client, body=LotRequest(lot="L3", product="basalt-8-16"), idempotency_key="one"
    )
    for _ in range(2)
]
assert [each.status_code for each in opened] == [201, 201]
assert opened[1].headers["Idempotent-Replayed"] == "true"
assert get_lot.sync("L3", client=client) == opened[0].parsed
assert {lot.lot for lot in list_lots.sync(client=client).items} == {"L1", "L2", "L3"}
assert report_file.sync("L1", ReportFormat.PDF, client=client).payload.read().startswith(b"%PDF")
problem = get_lot.sync("L9", client=client)
assert isinstance(problem, Problem) and problem.type_ == "urn:stonefall:problem:unknown-lot"
print("all calls were answered as described")
"""


async def try_client(generator: Path, folder: Path) -> int:
    """Generate a client into `folder`, let it ask a served store, and return its exit status."""
    generating = await asyncio.create_subprocess_exec(
        *(str(generator), "generate", "--path", str(DEPLOY / "openapi.json")),
        *("--config", str(DEPLOY / "openapi-python-client.yaml"), "--meta", "none"),
        *("--output-path", str(folder / "stonefall_client")),
    )
    if await generating.wait() != 0:
        return 1
    calls = folder / "calls.py"
    calls.write_text(CALLS, encoding="utf-8")
    with open_store(folder / "store") as store:
        session = await store.begin_session({"calibration_id": "0123", "is_simulated": True})
        await fill(store, session, folder / "out")
        settings = RecordingsSettings(reserve_gb=0.0)
        recordings = open_recordings(folder / "recordings", SOURCE, settings, {"command": "test"})
        control = FakeControl(recordings, calibrations=open_desk(folder / "desk"))
        async with served_by(app_of(store, control)) as served:
            address = f"http://127.0.0.1:{served.port}"
            python = str(generator.parent / "python")
            return await (await asyncio.create_subprocess_exec(python, str(calls), address)).wait()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("generator", type=Path, help="openapi-python-client in an environment of its own")
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(asyncio.run(try_client(parser.parse_args().generator, Path(folder))))
