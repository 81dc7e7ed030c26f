"""Generate a client from `deploy/openapi.json`, in Python, TypeScript or Java, and make its calls on a served store.

The generators are no requirement of ours, so they have an environment of their own:

    python3 -m venv /tmp/generator && /tmp/generator/bin/pip install openapi-python-client openapi-generator-cli
    .venv/bin/python tests/benchmarks/generated_client.py python /tmp/generator/bin/openapi-python-client
    .venv/bin/python tests/benchmarks/generated_client.py java \\
        /tmp/generator/lib/python3.11/site-packages/openapi_generator_cli/openapi-generator.jar
    npm --prefix /tmp/generator install openapi-typescript@7 openapi-fetch typescript@5 @types/node
    .venv/bin/python tests/benchmarks/generated_client.py typescript /tmp/generator/node_modules

Java needs a JDK 17; the generator's jar has the JSON library that the client needs.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from asyncio import create_subprocess_exec, run
from enum import StrEnum
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from api.test_api_contract import fill
from support.calibration_desk import open_desk
from support.recordings import SOURCE
from support.rest import FakeControl, app_of
from support.served import served_by

from service.recording.recordings import Recordings, RecordingsSettings
from service.store import open_store

DEPLOY = Path(__file__).parents[2] / "deploy"
JAVA_CALLS = Path(__file__).with_name("Calls.java")
TYPESCRIPT_CALLS = Path(__file__).with_name("calls.ts")
ANNOTATION = """
package javax.annotation;
public @interface Generated { String[] value(); String date(); String comments(); }
"""
"""What the client marks its classes with; the JDK has it no more, a project has it of jakarta.annotation-api 1.3."""
PYTHON_CALLS = """
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


class Language(StrEnum):
    """Languages of clients that are tried."""

    PYTHON = "python"
    TYPESCRIPT = "typescript"
    JAVA = "java"


def python_client(generator: Path, folder: Path) -> list[str]:
    """Generate a client in Python, and return the command that makes its calls; it lacks the address."""
    subprocess.run(
        [
            *(str(generator), "generate", "--path", str(DEPLOY / "openapi.json")),
            *("--config", str(DEPLOY / "openapi-python-client.yaml"), "--meta", "none"),
            *("--output-path", str(folder / "stonefall_client")),
        ],
        check=True,
    )
    calls = folder / "calls.py"  # beside the package that it imports
    calls.write_text(PYTHON_CALLS, encoding="utf-8")
    return [str(generator.parent / "python"), str(calls)]


def typescript_client(packages: Path, folder: Path) -> list[str]:
    """Generate types for a client in TypeScript, compile its calls, and return their command; it lacks the address."""
    (folder / "node_modules").symlink_to(packages)  # where both compiler and calls look for packages
    programs, types = packages / ".bin", folder / "stonefall.ts"
    subprocess.run([programs / "openapi-typescript", DEPLOY / "openapi.json", "-o", types], check=True)
    calls = Path(shutil.copy(TYPESCRIPT_CALLS, folder))
    compile_calls = [programs / "tsc", "--strict", "--target", "es2022", "--module", "node16", calls]
    subprocess.run(compile_calls, check=True, cwd=folder)
    return ["node", str(calls.with_suffix(".js"))]


def java_client(generator: Path, folder: Path) -> list[str]:
    """Generate a client in Java, compile it, and return the command that makes its calls; it lacks the address."""
    subprocess.run(
        [
            *("java", "-jar", str(generator), "generate", "-i", str(DEPLOY / "openapi.json"), "-g", "java"),
            *("-c", str(DEPLOY / "openapi-generator-java.yaml"), "-o", str(folder / "client")),
        ],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    (folder / "Generated.java").write_text(ANNOTATION, encoding="utf-8")
    sources = [*folder.glob("client/src/main/**/*.java"), folder / "Generated.java", JAVA_CALLS]
    listed, classes = folder / "sources", folder / "classes"
    listed.write_text("\n".join(map(str, sources)), encoding="utf-8")
    subprocess.run(["javac", "-d", str(classes), "-cp", str(generator), f"@{listed}"], check=True)
    return ["java", "-enableassertions", "-cp", f"{classes}:{generator}", "Calls"]


CLIENTS = {
    Language.PYTHON: python_client,
    Language.TYPESCRIPT: typescript_client,
    Language.JAVA: java_client,
}


async def try_client(language: Language, generator: Path, folder: Path) -> int:
    """Generate a client into `folder`, let it ask a served store, and return its exit status."""
    command = CLIENTS[language](generator, folder)
    with open_store(folder / "store") as store:
        session = await store.begin_session({"calibration_id": "0123", "is_simulated": True})
        await fill(store, session, folder / "out")
        settings = RecordingsSettings(reserve_gb=0.0)
        recordings = Recordings(folder / "recordings", SOURCE, settings, {"command": "test"})
        control = FakeControl(recordings, calibrations=open_desk(folder / "desk"))
        async with served_by(app_of(store, control)) as served:
            return await (await create_subprocess_exec(*command, f"http://127.0.0.1:{served.port}")).wait()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("language", type=Language, choices=list(Language))
    parser.add_argument(
        "generator", type=Path, help="openapi-python-client, node_modules, or openapi-generator.jar"
    )
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(run(try_client(arguments.language, arguments.generator.absolute(), Path(folder))))
