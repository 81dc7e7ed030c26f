"""Run the daemon on sixteen simulated GigE cameras and report losses, delays, processor time and memory.

Run: .venv/bin/python tests/benchmarks/live.py [--seconds 300] [--rate 4] [--size-mm 5] [--loss 0] [--keep-raw 0]
     [--segmenter auto|onnx|background]
Exits with 1 if a stone is missing or lost, the counts of driver and simulator differ, or memory grows.
"""

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from datetime import datetime
from pathlib import Path
from typing import Any, get_args

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.daemon_process import STONEFALL, DaemonProcess, descendants_of
from support.printed import show
from support.simulator_process import SimulatorProcess
from support.stone_recording import write_stones
from support.usage import cpu_s, percentiles, rss_mb

from pipeline.segmentation.segmenter_choice import SegmenterKind
from pipeline.synthesis.bundles import TRIGGER_DELAY_NS

N_STONES = 20
N_EMPTY = 2
ADDRESS = "127.44.0.2"
WARM_UP_S = 30.0
MAX_GROWTH_MB = 40.0
"""Accepted growth of the daemon's memory after the warm-up; a leak of one image a second would be 350 MB."""
POLL_S = 2.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=300)
    parser.add_argument("--rate", type=float, default=4)
    parser.add_argument("--size-mm", type=float, default=5)
    parser.add_argument("--loss", type=float, default=0, help="probability of losing a packet")
    parser.add_argument("--keep-raw", type=int, default=0)
    parser.add_argument(
        "--segmenter",
        choices=get_args(SegmenterKind),
        default="auto",
        help="onnx: the network segments every view",
    )
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, tempfile.TemporaryDirectory(dir="/dev/shm") as spool:
        folder = Path(name)
        write_stones(
            folder / "recording",
            "round",
            size_mm=arguments.size_mm,
            n_stones=N_STONES,
            n_empty=N_EMPTY,
            seed=11,
        )
        with SimulatorProcess(
            folder, folder / "recording", rate_hz=arguments.rate, address=ADDRESS
        ) as simulator:
            return soak(folder, spool, simulator, arguments)


def soak(folder: Path, spool: str, simulator: SimulatorProcess, arguments: Any) -> int:
    with DaemonProcess(
        folder,
        folder,
        rig=simulator.section,
        segmentation=f'segmenter = "{arguments.segmenter}"',
        voxels=256,
        spool=spool,
        store=f"keep_raw = {arguments.keep_raw}",
        slots=2,
        command=(STONEFALL,),
    ) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/acquisition", lambda now: now["state"] == "armed" and now["cameras_armed"] == 16)
        daemon.wait_for("/accounting", lambda now: now["backgrounds"] == 2)
        time.sleep(1)
        simulator.ask({"do": "fault", "of": "cameras", "set": {"packet_loss": arguments.loss}})
        samples = watch(simulator, daemon, arguments.seconds)
        counted = settle(simulator, daemon)
        return report(daemon, samples, counted, arguments)


def watch(simulator: SimulatorProcess, daemon: DaemonProcess, seconds: float) -> list[dict[str, float]]:
    samples = []
    simulator.ask({"do": "start"})
    begin = time.monotonic()
    while (elapsed_s := time.monotonic() - begin) < seconds:
        time.sleep(POLL_S)
        health = daemon.get("/health")["checks"]
        samples.append(
            {
                "at_s": elapsed_s,
                "rss_mb": rss_mb(daemon.process.pid),
                "loop_ms": health["loop"]["observed_value"],
                "waiting": health["queue"]["observed_value"],
                "daemon_cpu_s": cpu_s([daemon.process.pid]),
                "workers_cpu_s": cpu_s(descendants_of(daemon.process.pid)),
                "simulator_cpu_s": cpu_s([simulator.process.pid]),
            }
        )
    return samples


def settle(simulator: SimulatorProcess, daemon: DaemonProcess) -> dict[str, Any]:
    """Stop the belt, wait until every bundle has its result, and return the simulator's counters."""
    simulator.ask({"do": "stop"})
    time.sleep(2)
    daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0, timeout_s=120)
    time.sleep(6)  # until every camera was examined once more
    return simulator.ask({"do": "counters"})


def report(
    daemon: DaemonProcess, samples: list[dict[str, float]], counted: dict[str, Any], arguments: Any
) -> int:
    counts, acquisition = daemon.get("/accounting"), daemon.get("/acquisition")
    cameras = {each["id"]: each for each in daemon.get("/cameras")["items"]}
    results: list[dict[str, Any]] = []
    while page := daemon.get(f"/results?after={len(results)}&limit=1000")["items"]:
        results += page
    steady = [each for each in samples if each["at_s"] > min(WARM_UP_S, arguments.seconds / 4)]
    first, last = steady[0], steady[-1]
    span_s = last["at_s"] - first["at_s"]
    growth_mb = last["rss_mb"] - first["rss_mb"]
    views = [len(result["views"]) for result in results]
    late_ms = [since_exposure_ms(result) for result in results]
    flagged = Counter(why for result in results for why in result["segmentation_flags"].values())
    differing = [
        camera
        for camera, seen in counted["cameras"].items()
        if cameras[camera]["frames"] + cameras[camera]["failed_frames"] != seen["frames"]
    ]
    table = Table(
        "", "found", title=f"{arguments.seconds:g} s, {arguments.rate:g} stones/s of {arguments.size_mm:g} mm"
    )
    rows = {
        "stones that fell (simulator)": counted["belt"]["stones"],
        "triggers = measured + rejected + lost": "{triggers} = {measured} + {rejected} + {lost}".format(
            **counts
        ),
        "by reason": counts["by_reason"],
        "bundles with 16, 15, fewer views": (
            f"{views.count(16)}, {views.count(15)}, {sum(n < 15 for n in views)}"
        ),
        f"views segmented by, asked for {arguments.segmenter}": dict(
            Counter(name for result in results for name in result["segmenters"].values())
        ),
        "views with a flag of their segmentation, three of the reasons": (
            f"{sum(flagged.values())}, {[why for why, _ in flagged.most_common(3)]}"
        ),
        "views not used": dict(
            Counter(why for result in results for why in result["dropped_views"].values())
        ),
        "edges a camera was too busy for (simulator)": sum(c["missed"] for c in counted["cameras"].values()),
        "frames sent by the simulator": sum(c["frames"] for c in counted["cameras"].values()),
        "frames received, failed (driver)": (
            f"{sum(c['frames'] for c in cameras.values())}, {sum(c['failed_frames'] for c in cameras.values())}"
        ),
        "packets resent (simulator, driver)": (
            f"{sum(c['resent'] for c in counted['cameras'].values())},"
            f" {sum(c['resent_packets'] for c in cameras.values())}"
        ),
        "cameras whose accounts differ": differing or "none",
        "orphans, unseen, in dead time": "{orphans}, {unseen}, {in_dead_time}".format(**acquisition),
        "longest hold-up of the loop, ms": max(each["loop_ms"] for each in samples),
        "bundles waiting, at most": max(each["waiting"] for each in samples),
        "latency trigger to frame, ms (mean, max)": (
            f"{sum(c['latency_ms'] for c in cameras.values()) / 16:.1f},"
            f" {max(c['latency_max_ms'] for c in cameras.values()):.1f}"
        ),
        "exposure to durable result, ms: p50, p95, p99, max": percentiles(late_ms),
        "daemon memory, MB (after the warm-up, at the end)": f"{first['rss_mb']:.0f}, {last['rss_mb']:.0f}",
        "cores used by daemon, workers, simulator": ", ".join(
            f"{(last[name] - first[name]) / span_s:.2f}"
            for name in ("daemon_cpu_s", "workers_cpu_s", "simulator_cpu_s")
        ),
        "load of the machine": f"{os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
    }
    for name, value in rows.items():
        table.add_row(name, str(value))
    show(table, as_json=arguments.json, width=130)
    problems = {
        "a stone has no trigger": counts["triggers"] != counted["belt"]["stones"],
        "the accounts do not add up": not counts["is_balanced"] or counts["in_progress"] != 0,
        "stones were lost": counts["lost"] > 0,
        "driver and simulator differ": bool(differing),
        "memory grows": growth_mb > MAX_GROWTH_MB,
    }
    for problem in (name for name, is_so in problems.items() if is_so):
        Console(stderr=True).print(f"FAILED: {problem}")
    return int(any(problems.values()))


def since_exposure_ms(result: dict[str, Any]) -> float:
    """Return the time from the exposure to the written result; both by the clock of this machine."""
    triggered, written = (datetime.fromisoformat(result[name]) for name in ("captured_at", "recorded_at"))
    return (written - triggered).total_seconds() * 1000 - TRIGGER_DELAY_NS / 1e6


if __name__ == "__main__":
    sys.exit(main())
