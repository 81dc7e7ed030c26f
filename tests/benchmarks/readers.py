"""Run the daemon on a recording, without clients and beside two crowds of them, and compare how late results are.

Run: .venv/bin/python tests/benchmarks/readers.py [--seconds 30] [--rate 4] [--size-mm 25] [--recording DIR]
     [--phases calm,polls,pages,calm] [--before 1000]

The crowds: 200 long polls that ask again at once; 4 clients in a closed loop, each with a page of 1000 results and
five previews in turn; as `cheap`, 16 clients in a closed loop with single results and a kept preview; and, as `lots`,
one client that opens a lot, assigns all stones of before to it, closes it and has it reported, then opens and closes
others and has the first reported again. As `browsers` five tabs of Chromium show the operator's page beside 200 long
polls; first paint and the newest stones with their picture are among the answers. As `rude` 20 clients read the
stream of results, 50 ask for a big page and do not read it, and one sends bodies of 100 MB. They run on this machine,
with the lowest priority (the browser's session too), because a plant's clients are other machines. The store holds
`--before` stones before, and all the time one client asks for the gradation of a lot of them, twice a second.
Times are from the exposure to the durable result. Exits with 1 if a stone is lost, or if the 99th percentile beside a
crowd is more than 1.5 times that of the calm phase before; beside `browsers` also if that of the gradation is.
"""

import argparse
import asyncio
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from crowds import CLIENTS, N_WITH_MESH
from rich.console import Console
from rich.table import Table
from sustained import DRAIN_S, LOOK_S, RIG, Watched

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.daemon_process import STONEFALL, DaemonProcess, descendants_of, process_name
from support.outcomes import add
from support.printed import show
from support.stone_recording import ROUND_GAP_S, write_paced, write_stones
from support.stores import folder_of
from support.usage import cpu_s, pss_mb

from drivers.files.recording import open_recording
from pipeline.gradation.stones import REQUIRED
from pipeline.synthesis.bundles import TRIGGER_DELAY_NS
from service.results.fields import STORED_FIELDS
from service.results.record import result_of
from service.store import open_store

SEED = 12
CROWDS = Path(__file__).with_name("crowds.py")
MAX_RATIO = 1.5
LOT, GRADATION_PAUSE_S = "before", 0.5
WARM_UP_S = 10.0
SETTLE_S = 3.0
"""Between two phases, once no stone waits any more; stones of that time are in none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Phase:
    """Figures of one phase."""

    name: str
    latency_ms: list[float]
    lost: int
    gradation_ms: list[float]
    answers: str
    cores: dict[str, float]
    memory_mb: float  # daemon and its processes together at the end (PSS)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=30, help="length of each phase")
    parser.add_argument("--rate", type=float, default=4, help="stones a second")
    parser.add_argument("--size-mm", type=float, default=25)
    parser.add_argument("--recording", type=Path, help="stones are rendered here, or taken from here")
    parser.add_argument("--before", type=int, default=N_WITH_MESH, help="stones in the store before")
    parser.add_argument("--phases", default="calm,polls,calm,pages,calm,cheap")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, tempfile.TemporaryDirectory(dir="/dev/shm") as spool:
        folder = Path(name)
        stones = arguments.recording or folder / "stones"
        if not stones.exists():
            write_stones(stones, "angular", size_mm=arguments.size_mm, n_stones=10, n_empty=1, seed=SEED)
        due_s = write_paced(folder / "recording", open_recording(stones), arguments.rate)
        apart_ms = 1000 * min(due_s[1], ROUND_GAP_S)
        daemon = DaemonProcess(
            folder,
            folder / "recording",
            rig=RIG.format(window_ms=0.4 * apart_ms, dead_time_ms=0.9 * apart_ms),
            voxels=256,
            spool=spool,
            slots=2,
            command=(STONEFALL,),
        )
        phases = run(daemon, due_s, arguments)
    return report(phases, arguments)


def run(daemon: DaemonProcess, due_s: np.ndarray, arguments: Any) -> list[Phase]:
    """Fill the store, then let stones fall through all phases."""
    state = daemon.folder / "state"
    with daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] >= 5)
        daemon.stop()
    asyncio.run(fill(state, arguments.before))
    daemon.heard.clear()
    watched, is_over = Watched(), threading.Event()
    gradations: list[tuple[float, float]] = []
    spans, cores, answers, memory_mb = [], [], [], []
    with daemon:
        daemon.hear("READY=1")
        with closing(sqlite3.connect(f"file:{state / 'results.sqlite'}?mode=ro", uri=True)) as connection:
            (session,) = connection.execute("SELECT max(session) FROM sessions").fetchone()
            (n_before,) = connection.execute(
                "SELECT max(trigger) FROM triggers WHERE session < ?", (session,)
            ).fetchone()
        watching = threading.Thread(target=watched.look, args=(state / "results.sqlite", is_over))
        watching.start()
        put_into_lot(daemon)
        asking = threading.Thread(target=ask_gradations, args=(daemon, gradations, is_over))
        asking.start()
        try:
            time.sleep(WARM_UP_S)
            for name in arguments.phases.split(","):
                begin_s, before = time.monotonic(), usage(daemon)
                answers.append(crowd_of(name, daemon, arguments.seconds))
                spans.append((begin_s, time.monotonic()))
                after = usage(daemon)
                cores.append(cores_between(before, after, spans[-1][1] - begin_s))
                memory_mb.append(sum(pss_mb(pid) for pid in after))
                daemon.wait_for("/accounting", lambda now: now["in_progress"] <= 1, timeout_s=DRAIN_S)
                time.sleep(SETTLE_S)
            daemon.put("/acquisition", {"state": "disarmed"})
            daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0, timeout_s=DRAIN_S)
        finally:
            time.sleep(10 * LOOK_S)
            is_over.set()
            watching.join()
            asking.join()
    with closing(sqlite3.connect(state / "results.sqlite")) as connection:
        rows = connection.execute(
            "SELECT seq, trigger, record ->> 'outcome' FROM results WHERE session = ? ORDER BY seq",
            (session,),
        ).fetchall()
    triggered_s = trigger_times_s(watched, n_before, due_s)
    stones = [
        (triggered_s[trigger - n_before - 1], watched.results_s[seq], outcome)
        for seq, trigger, outcome in rows
    ]
    return [
        Phase(
            name=name,
            latency_ms=[
                1000 * (ended_s - begun_s) - TRIGGER_DELAY_NS / 1e6
                for begun_s, ended_s, outcome in stones
                if begin_s <= begun_s < end_s and outcome != "lost"
            ],
            gradation_ms=[1000 * took_s for at_s, took_s in gradations if begin_s <= at_s < end_s],
            lost=sum(outcome == "lost" and begin_s <= begun_s < end_s for begun_s, _, outcome in stones),
            answers=said,
            cores=busy,
            memory_mb=used_mb,
        )
        for name, (begin_s, end_s), said, busy, used_mb in zip(
            arguments.phases.split(","), spans, answers, cores, memory_mb, strict=True
        )
    ]


async def fill(state: Path, n_stones: int) -> None:
    """Store the first measured stone again and again in other sizes, the first ones with its mesh."""
    with closing(sqlite3.connect(state / "results.sqlite")) as connection:
        texts = connection.execute("SELECT record FROM results").fetchall()
    records = [json.loads(text) for (text,) in texts]
    record = next(each for each in records if each["outcome"] == "measured")
    mesh = folder_of(state, record["id"]) / "mesh.sfmesh"
    with open_store(state, keep_raw=0) as store:
        session = await store.begin_session(
            {"calibration_id": record["calibration_id"], "is_simulated": True}
        )
        scales = np.random.default_rng(SEED).lognormal(0.0, 0.2, n_stones)
        for number, scale in enumerate(scales):
            fields = {name: value for name, value in record.items() if name not in STORED_FIELDS}
            lengths = [name for name in REQUIRED if name.endswith("_mm")]
            fields |= {name: scale * fields[name] for name in lengths}
            fields["volume_mm3"] *= scale**3
            files = {}
            if number < N_WITH_MESH:
                files = {"mesh.sfmesh": Path(shutil.copy(mesh, state / "copy.sfmesh"))}
            await add(store, session, number, result_of(fields), files)


def trigger_times_s(watched: Watched, n_before: int, due_s: np.ndarray) -> np.ndarray:
    """Return when each trigger came: no later than the next ones less the scheduled time between."""
    seen_s = np.array([at_s for number, at_s in sorted(watched.triggers_s.items()) if number > n_before])
    round_of, position = np.divmod(np.arange(len(seen_s)), len(due_s) - 1)
    schedule_s = round_of * due_s[-1] + due_s[position]
    return np.asarray(np.minimum.accumulate((seen_s - schedule_s)[::-1])[::-1] + schedule_s)


def put_into_lot(daemon: DaemonProcess) -> None:
    daemon.put("/products/before", {"title": "before", "density_kg_m3": 2700})
    daemon.post("/lots", {"lot": LOT, "product": "before"})
    daemon.post(f"/lots/{LOT}/assign", {"since": "2000-01-01T00:00:00Z", "until": "2100-01-01T00:00:00Z"})
    daemon.post(f"/lots/{LOT}/close", {})


def ask_gradations(daemon: DaemonProcess, times: list[tuple[float, float]], is_over: threading.Event) -> None:
    """Note when each gradation was asked for, and how long it took, s."""
    while not is_over.wait(GRADATION_PAUSE_S):
        began_s = time.monotonic()
        daemon.get(f"/lots/{LOT}/gradation")
        times.append((began_s, time.monotonic() - began_s))


def crowd_of(name: str, daemon: DaemonProcess, seconds: float) -> str:
    """Have the crowd ask for so long; return what it got."""
    if name not in CLIENTS:
        time.sleep(seconds)
        return "-"
    command = ["nice", "-n", "19", sys.executable, CROWDS, name, daemon.url(""), str(seconds)]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def usage(daemon: DaemonProcess) -> dict[int, tuple[str, float]]:
    """Return name and processor time of the daemon and of its processes."""
    pids = [daemon.process.pid, *descendants_of(daemon.process.pid)]
    return {pid: (process_name(pid), cpu_s([pid])) for pid in pids}


def cores_between(
    before: dict[int, tuple[str, float]], after: dict[int, tuple[str, float]], span_s: float
) -> dict[str, float]:
    cores: dict[str, float] = {}
    for pid, (name, seconds) in after.items():
        cores[name] = cores.get(name, 0.0) + (seconds - before.get(pid, (name, 0.0))[1]) / span_s
    return cores


def report(phases: list[Phase], arguments: Any) -> int:
    table = Table(
        *(
            "",
            "stones",
            "lost",
            "p50 ms",
            "p95",
            "p99",
            "p99 by calm",
            "gradation p50 ms",
            "gradation p99",
            "gradation by calm",
            "answers",
            "cores",
            "MB",
        ),
        title=f"{arguments.rate:g} stones a second of {arguments.size_mm:g} mm, {arguments.seconds:g} s each;"
        f" load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
    )
    calm_ms, calm_gradation_ms, problems = float("nan"), float("nan"), []
    for phase in phases:
        p50, p95, p99 = np.quantile(phase.latency_ms or [np.nan], [0.5, 0.95, 0.99])
        gradation_p50, gradation_p99 = np.quantile(phase.gradation_ms or [np.nan], [0.5, 0.99])
        if phase.name == "calm":
            calm_ms, calm_gradation_ms = p99, gradation_p99
        if phase.lost or p99 > MAX_RATIO * calm_ms:
            problems.append(f"{phase.name}: {phase.lost} lost, p99 {p99 / calm_ms:.2f} times as long")
        slower = gradation_p99 / calm_gradation_ms
        if phase.name == "browsers" and slower > MAX_RATIO:
            problems.append(f"{phase.name}: gradations, p99 {slower:.2f} times as long")
        busy = ", ".join(f"{name} {used:.2f}" for name, used in phase.cores.items() if used >= 0.01)
        figures = (f"{p50:.0f}", f"{p95:.0f}", f"{p99:.0f}", f"{p99 / calm_ms:.2f}")
        n_stones = len(phase.latency_ms) + phase.lost
        table.add_row(
            phase.name,
            str(n_stones),
            str(phase.lost),
            *figures,
            *(f"{gradation_p50:.0f}", f"{gradation_p99:.0f}", f"{slower:.2f}"),
            phase.answers,
            busy,
            f"{phase.memory_mb:.0f}",
        )
    show(table, as_json=arguments.json)
    for problem in problems:
        Console(stderr=True).print(f"FAILED: {problem}")
    return int(any(problems))


if __name__ == "__main__":
    sys.exit(main())
