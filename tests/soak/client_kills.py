"""Kill the daemon or its client again and again while stones fall, and compare what both have in the end.

    .venv/bin/python tests/soak/client_kills.py [--kills 100] [--seed 0] [--bridge]

A recording is replayed in a loop, ten stones a second; `deploy/client.py` follows, or an outlet of the bridge. One of
the two is killed (SIGKILL) at random moments, also while it starts, and started again at once. In the end the client's
store must have each result of the daemon once, with all its fields, and nothing else.
"""

import argparse
import json
import random
import sqlite3
import sys
import tempfile
import time
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

if __package__ is None:
    sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]

from soak.kills import all_results
from support.daemon_process import PATIENCE_S, DaemonProcess, free_port
from support.eventually import eventually
from support.recording_outlet import DATABASE, start_bridge
from support.reference_client import start_client
from support.small_recording import write_small_recording

RIG = "loop = true\nspeed = 2.5"
DAEMON_SHARE = 0.5
"""Share of the kills that strike the daemon."""
UNREADY_SHARE = 0.2
"""Share of the daemons that are killed at any moment of their start; the others measure before."""
START_S, LIFE_S = 3.0, 1.0
DRAIN_S = 600.0
"""Longest time for what waits in the end."""


@dataclass(frozen=True, slots=True)
class Tally:
    """What the daemon has in the end, what the client has, and how often each was killed."""

    results: list[dict[str, Any]]
    stored: list[dict[str, Any]]
    kills: dict[str, int]


def killed_again_and_again(folder: Path, n_kills: int, seed: int = 0, *, is_bridge: bool = False) -> Tally:
    """Run the bench; fails when the client lacks a result, has one twice, or has another."""
    dice = random.Random(seed)  # noqa: S311 - nothing secret
    recording, database = folder / "recording", folder / DATABASE
    write_small_recording(recording, n_stones=8)
    port = free_port()
    kills = {"daemon": 0, "client": 0}

    def follow() -> Any:
        url = f"http://127.0.0.1:{port}"
        if is_bridge:
            return start_bridge(url, folder)
        return start_client(url, database, "--consumer", "mes", "--fields", "all")

    client = follow()
    try:
        while True:
            with DaemonProcess(folder, recording, rig=RIG, slots=2, port=port) as daemon:
                is_left_to_start = dice.random() > UNREADY_SHARE or sum(kills.values()) == n_kills
                if is_left_to_start:
                    daemon.hear("READY=1")
                    n_before = daemon.get("/accounting")["measured"]
                    daemon.wait_for("/accounting", lambda now, n=n_before: now["measured"] > n)
                while sum(kills.values()) < n_kills and dice.random() > DAEMON_SHARE:
                    time.sleep(dice.uniform(0, LIFE_S))
                    client.kill()
                    client.wait()
                    client = follow()
                    kills["client"] += 1
                if sum(kills.values()) < n_kills:
                    time.sleep(dice.uniform(0, LIFE_S if is_left_to_start else START_S))
                    daemon.process.kill()
                    kills["daemon"] += 1
                    continue
                results = all_in_the_end(daemon)
                wait_for_all(database, len(results))
                client.send_signal(2)
                assert client.wait(PATIENCE_S) == (0 if is_bridge else 130)
                tally = Tally(results, stored(database), kills)
                break
    finally:
        client.kill()
        client.wait()
    assert tally.stored == tally.results, difference(tally)
    assert len({(result["session"], result["bundle"]) for result in tally.stored}) == len(tally.results)
    said = database.with_suffix(".log").read_text()
    assert "Traceback" not in said, said
    return tally


def all_in_the_end(daemon: DaemonProcess) -> list[dict[str, Any]]:
    """Let no more stones fall, and return all results."""
    daemon.put("/acquisition", {"state": "disarmed"})
    daemon.wait_for("/acquisition", lambda now: now["state"] == "disarmed")
    counts = daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0, timeout_s=DRAIN_S)
    results = all_results(daemon)
    assert counts["is_balanced"]
    assert counts["triggers"] == len(results)
    return results


def wait_for_all(database: Path, n: int) -> None:
    """Return once the client has so many results."""
    eventually(lambda: len(stored(database)) >= n, PATIENCE_S)


def stored(database: Path) -> list[dict[str, Any]]:
    """Return the results that the client has, in their order."""
    with closing(sqlite3.connect(database, timeout=60)) as connection:
        return [
            json.loads(record) for (record,) in connection.execute("SELECT record FROM stones ORDER BY seq")
        ]


def difference(tally: Tally) -> str:
    """Return how the two stores differ, in a line."""
    theirs, own = ({result["id"]: result for result in each} for each in (tally.results, tally.stored))
    others = [id_ for id_ in theirs.keys() & own.keys() if theirs[id_] != own[id_]]
    return f"lost: {theirs.keys() - own.keys()}, other: {own.keys() - theirs.keys()}, different: {others}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bridge", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="client-kills-") as folder:
        tally = killed_again_and_again(
            Path(folder), arguments.kills, arguments.seed, is_bridge=arguments.bridge
        )
    kills = ", ".join(f"{n} of the {name}" for name, n in tally.kills.items())
    print(f"{arguments.kills} kills ({kills}): {len(tally.stored)} results, each once")  # noqa: T201


if __name__ == "__main__":
    main()
