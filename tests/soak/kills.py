"""Kill the daemon again and again while stones fall, and compare its accounting with what the simulated rig counted.

    .venv/bin/python tests/soak/kills.py [--kills 200] [--seed 0]

Sixteen simulated cameras and a gate run on; stones fall, four a second, whether a daemon runs or not. It is killed
(SIGKILL) at random moments: while it starts, while it arms, while it measures. In the end every stone that the gate
counted must have exactly one outcome, and every bundle that lay whole in the spool at a kill must have been measured.
"""

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

if __package__ is None:
    sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[2])]

from support.daemon_process import DaemonProcess, is_running
from support.eventually import eventually
from support.left_in_spool import open_triggers, whole_bundles
from support.live_rig import live_section, simulated_rig
from support.small_recording import write_small_recording

from drivers.files.recording import open_recording
from service.results.fields import Outcome

UNARMED_SHARE = 0.2
"""Share of the daemons that are killed at any moment of their start; the others measure for a while."""
START_S = 6.0
LIFE_S = 4.0
JAM_SHARE = 0.5
JAM_S = 2.0
QUIET_S = 2.0
DRAIN_S = 600.0
"""Longest time for what waits in the end."""


@dataclass(frozen=True, slots=True)
class Balance:
    """What fell, and what became of it."""

    fallen: int  # stones counted by the gate
    spooled: int  # bundles that lay whole in the spool at a kill, each counted once
    results: list[dict[str, Any]]

    @property
    def outcomes(self) -> Counter[str]:
        return Counter(
            result["outcome"] if result["reason"] is None else f"{result['outcome']}, {result['reason']}"
            for result in self.results
        )


def killed_again_and_again(folder: Path, n_kills: int, seed: int = 0, number: int = 20) -> Balance:
    """Run the bench; fails when a stone has no outcome, has two, or a whole bundle was not measured."""
    dice = random.Random(seed)  # noqa: S311 - nothing secret
    recording = folder / "recording"
    write_small_recording(recording, n_stones=6, n_backgrounds=3)
    cameras = open_recording(recording).camera_ids
    spooled: set[tuple[int, str]] = set()
    with simulated_rig(folder, recording, number=number, only_stones=True) as rig:
        section = live_section(rig, folder, recording, by_address=True)
        for kill in range(n_kills):
            with DaemonProcess(folder, recording, rig=section, slots=2) as daemon:
                if kill == 0:
                    daemon.hear("READY=1")
                    daemon.wait_for("/accounting", lambda counts: counts["backgrounds"] == 2)
                    rig.belt.start()
                    daemon.wait_for("/accounting", lambda counts: counts["triggers"] >= 1)
                elif dice.random() > UNARMED_SHARE:
                    daemon.hear("READY=1")
                    time.sleep(dice.uniform(0, LIFE_S))
                else:
                    time.sleep(dice.uniform(0, START_S))
                workers = daemon.worker_pids()
                if dice.random() < JAM_SHARE:  # so that bundles pile up in the spool
                    daemon.signal_workers(signal.SIGSTOP)
                    time.sleep(dice.uniform(0, JAM_S))
                daemon.process.kill()
                daemon.process.wait()
                for pid in workers:  # one that is stopped would not see the daemon end
                    with suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGCONT)
                eventually(lambda pids=workers: not any(is_running(pid) for pid in pids))
                now = whole_bundles(folder, cameras)
                spooled |= now
                print(f"kill {kill + 1}: {len(open_triggers(folder))} open, {len(now)} in the spool")  # noqa: T201
        with DaemonProcess(folder, recording, rig=section, slots=2) as daemon:
            daemon.hear("READY=1")
            fallen = rig.gate.counters.edges
            daemon.wait_for(
                "/acquisition", lambda now: now["state"] == "armed" and now["cameras_armed"] == 16
            )
            eventually(lambda: rig.gate.counters.edges > fallen)
            rig.belt.stop()
            daemon.wait_for("/acquisition", lambda now: (now["last_stone_age_s"] or 0) > QUIET_S)
            daemon.wait_for("/accounting", lambda counts: counts["in_progress"] == 0, timeout_s=DRAIN_S)
            balance = Balance(rig.gate.counters.edges, len(spooled), all_results(daemon))
            assert daemon.get("/accounting")["is_balanced"]
            assert daemon.stop() == 0
    outcome = {(result["session"], result["bundle"]): result for result in balance.results}
    assert len(outcome) == len(balance.results) == balance.fallen, (balance.fallen, balance.outcomes)
    wasted = [outcome[key] for key in spooled if outcome[key]["outcome"] == Outcome.LOST]
    assert not wasted, [(result["bundle"], result["outcome"], result["reason"]) for result in wasted]
    return balance


def all_results(daemon: DaemonProcess) -> list[dict[str, Any]]:
    results: list[dict[str, Any]] = []
    while page := daemon.get(f"/results?after={len(results)}&limit=500")["items"]:
        results += page
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        balance = killed_again_and_again(Path(folder), arguments.kills, arguments.seed)
    print(f"{arguments.kills} kills: {balance.fallen} stones fell, each has one outcome")  # noqa: T201
    print(f"{balance.spooled} lay in the spool at a kill, all of them are measured")  # noqa: T201
    for outcome, n in sorted(balance.outcomes.items()):
        print(f"{n:6d} {outcome}")  # noqa: T201


if __name__ == "__main__":
    main()
