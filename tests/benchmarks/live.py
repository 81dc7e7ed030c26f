"""Run the daemon on sixteen simulated GigE cameras and report losses, delays, processor time and memory.

Run: .venv/bin/python tests/benchmarks/live.py [--seconds 300] [--rate 4] [--size-mm 5] [--loss 0] [--keep-raw 0]
     [--segmenter auto|onnx|background]
     .venv/bin/python tests/benchmarks/live.py --rates 4,10,20,30 [--seconds 30] [--size-mm 15]    a table by rate
     .venv/bin/python tests/benchmarks/live.py --receiving [--seconds 20] [--rate 4]    receives alone, in several ways
Exits with 1 if a stone is missing or lost, the counts of driver and simulator differ, or memory grows.

With `--rates` the gate makes the delay, several stones are in the air, images have a quarter of the pixels in each
direction, as two cores do not simulate sixteen whole cameras so fast, and stones pass the gate at 1.4 m/s; each rate
with estimates only, and refined while there is time.
"""

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
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
from support.usage import cpu_s, percentiles, rss_mb, thread_cpu_s

from drivers.camera_process.camera import RemoteCamera
from drivers.camera_process.process import CameraProcess
from drivers.cameras.aravis import AravisCamera
from drivers.cameras.aravis_library import load_aravis
from drivers.cameras.frame_reader import Allocate
from drivers.cameras.genicam import GigeCameraSettings, exposure_features, trigger_features
from drivers.factory import ARAVIS
from drivers.interfaces import DeviceEvent, EventSink
from pipeline.frames import CameraId, Frame
from pipeline.segmentation.segmenter_choice import SegmenterKind
from pipeline.synthesis.bundles import TRIGGER_DELAY_NS

N_STONES = 20
N_EMPTY = 2
ADDRESS = "127.44.0.2"
WARM_UP_S = 30.0
MAX_GROWTH_MB = 40.0
"""Accepted growth of the daemon's memory after the warm-up; a leak of one image a second would be 350 MB."""
POLL_S = 2.0
IDLE_S = 8.0
SETTLE_S = 2.0
GATE_SPEED_MM_S = 1400.0
"""Speed of stones at the beam after a fall of 100 mm: at 30 a second it is open again before the next one."""
ARAVIS_THREAD = "arv_gv_stream"
"""Name of the threads in which Aravis receives packets, one a camera."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=300)
    parser.add_argument("--rate", type=float, default=4)
    parser.add_argument("--size-mm", type=float, default=5)
    parser.add_argument("--rates", type=lambda text: [float(rate) for rate in text.split(",")], default=[])
    parser.add_argument("--loss", type=float, default=0, help="probability of losing a packet")
    parser.add_argument("--keep-raw", type=int, default=0)
    parser.add_argument(
        "--segmenter",
        choices=get_args(SegmenterKind),
        default="auto",
        help="onnx: the network segments every view",
    )
    parser.add_argument(
        "--receiving",
        action="store_true",
        help="processor time of a frame in stonefall-cams, without a daemon",
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
            speed_mm_s=GATE_SPEED_MM_S if arguments.rates else None,
        )
        if arguments.rates:
            return by_rate(folder, spool, arguments)
        with SimulatorProcess(
            folder, folder / "recording", rate_hz=arguments.rate, address=ADDRESS
        ) as simulator:
            if arguments.receiving:
                return compare_receiving(simulator, arguments)
            return soak(folder, spool, simulator, arguments)


def by_rate(folder: Path, spool: str, arguments: Any) -> int:
    """Let stones fall at each rate, and show what is lost and what a stone costs; 1 if any is lost."""
    table = Table(
        "stones/s, body asked for",
        "fell",
        "lost",
        "with 16 views",
        "refined",
        "ms to result: p50, p95, p99, max",
        "processor ms a stone: daemon",
        "workers, cameras",
        "simulator",
        title=f"{arguments.seconds:g} s each, {arguments.size_mm:g} mm, images of 320 x 256 px",
    )
    n_lost = 0
    for rate_hz in arguments.rates:
        for body in ("estimate", "photo"):
            folder_of_run = folder / f"{rate_hz:g}-{body}"
            folder_of_run.mkdir()
            with SimulatorProcess(
                folder_of_run, folder / "recording", rate_hz=rate_hz, address=ADDRESS
            ) as simulator:
                row, lost = run_at(folder_of_run, spool, simulator, body, arguments)
            n_lost += lost
            table.add_row(f"{rate_hz:g}, {body}", *row)
    show(table, as_json=arguments.json, width=150)
    return int(n_lost > 0)


def run_at(
    folder: Path, spool: str, simulator: SimulatorProcess, body: str, arguments: Any
) -> tuple[list[str], int]:
    """Return a row of the table, and how many stones were lost or have no trigger."""
    with DaemonProcess(
        folder,
        folder,
        rig=simulator.section.replace("is_simulated", 'delay = "gate"\nis_simulated'),
        voxels=256,
        spool=spool,
        body=body,
        slots=2,
        command=(STONEFALL,),
    ) as daemon:
        wait_until_armed(daemon)

        def spent_s() -> list[float]:
            pid = daemon.process.pid
            groups = ([pid], [each for each in descendants_of(pid) if each != pid], [simulator.process.pid])
            return [cpu_s(each) for each in groups]

        before_s = spent_s()
        simulator.ask({"do": "start"})
        time.sleep(arguments.seconds)
        simulator.ask({"do": "stop"})
        time.sleep(POLL_S)
        while daemon.get("/accounting")["in_progress"]:
            time.sleep(POLL_S)  # asking costs the daemon time, too
        after_s = spent_s()
        counted, counts = simulator.ask({"do": "counters"}), daemon.get("/accounting")
        results: list[dict[str, Any]] = []
        while page := daemon.get(f"/results?after={len(results)}&limit=1000")["items"]:
            results += page
    fell = counted["belt"]["stones"]
    lost = counts["lost"] + fell - counts["triggers"]
    costs_ms = [
        f"{1e3 * (after - before) / fell:.0f}" for before, after in zip(before_s, after_s, strict=True)
    ]
    return [
        str(fell),
        str(lost),
        str(sum(len(result["views"]) == 16 for result in results)),
        str(sum(result["body"] == "photo" for result in results)),
        percentiles([since_exposure_ms(result) for result in results]),
        *costs_ms,
    ], lost


def wait_until_armed(daemon: DaemonProcess) -> None:
    daemon.hear("READY=1")
    daemon.wait_for("/acquisition", lambda now: now["state"] == "armed" and now["cameras_armed"] == 16)
    daemon.wait_for("/accounting", lambda now: now["backgrounds"] == 2)
    time.sleep(1)


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
        wait_until_armed(daemon)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Receiving:
    """A way to receive frames."""

    name: str
    packet_bytes: int = 8192
    n_buffers: int = 8
    receive_buffer_bytes: int = 4 << 20
    driver: str = ARAVIS


WAYS = (
    Receiving(name="as it is"),
    Receiving(name="packets of 9000 bytes", packet_bytes=9000),
    Receiving(name="packets of 1500 bytes", packet_bytes=1500),
    Receiving(name="3 buffers", n_buffers=3),
    Receiving(name="socket of 16 MB", receive_buffer_bytes=16 << 20),
    Receiving(name="socket of a quarter MB", receive_buffer_bytes=1 << 18),
    Receiving(name="images copied once more", driver="benchmarks.live:copying_camera"),
    Receiving(name="packet socket", driver="benchmarks.live:packet_socket_camera"),
)


def copying_camera(settings: GigeCameraSettings, allocate: Allocate, last: Any) -> AravisCamera:
    """Make a camera whose frames are copied before they are handed on."""

    class Copied(AravisCamera):
        def arm(self, sink: EventSink) -> None:
            super().arm(CopyingSink(sink))

    return Copied(settings, allocate, last)


def packet_socket_camera(settings: GigeCameraSettings, allocate: Allocate, last: Any) -> AravisCamera:
    """Make a camera whose stream may read its packets before UDP does, which needs CAP_NET_RAW."""
    load_aravis(settings.id).Camera.gv_set_stream_options = lambda *_: None
    return AravisCamera(settings, allocate, last)


class CopyingSink:
    """Copies each image into memory of its own, and hands on the original."""

    def __init__(self, sink: EventSink) -> None:
        self._sink = sink

    def deliver(self, event: DeviceEvent) -> bool:
        if isinstance(event, Frame):
            event.image.copy()
        return self._sink.deliver(event)


class Counting:
    """Counts the frames that come, and lets them go."""

    def __init__(self) -> None:
        self.n_frames = 0

    def deliver(self, event: DeviceEvent) -> bool:
        self.n_frames += isinstance(event, Frame)
        return True


def compare_receiving(simulator: SimulatorProcess, arguments: Any) -> int:
    """Receive in each way, and show what a frame costs in the process of the cameras; 1 if the first way loses one."""
    table = Table(
        "by",
        "sent, received",
        "packets resent",
        "ms of a frame",
        "in Aravis' threads",
        "in ours",
        "cores without frames",
        title=f"{len(simulator.cameras)} cameras, {arguments.rate:g} bundles/s, {arguments.seconds:g} s each",
    )
    # where the process finds the ways below
    os.environ["PYTHONPATH"] = os.pathsep.join(
        [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    )
    missing = []
    for way in WAYS:
        sent, received, resent, idle, spent_s = received_by(way, simulator, arguments.seconds)
        missing.append(sent - received)
        aravis_ms = 1e3 * spent_s.pop(ARAVIS_THREAD) / max(received, 1)
        ours_ms = 1e3 * sum(spent_s.values()) / max(received, 1)
        costs = [f"{ms:.2f}" for ms in (aravis_ms + ours_ms, aravis_ms, ours_ms)]
        table.add_row(way.name, f"{sent}, {received}", str(resent), *costs, f"{idle:.3f}")
    show(table, as_json=arguments.json, width=150)
    return int(missing[0] != 0)


def received_by(
    way: Receiving, simulator: SimulatorProcess, seconds: float
) -> tuple[int, int, int, float, dict[str, float]]:
    """Return the frames sent and received, packets resent, cores used without frames, and seconds more with them.

    These are by the names of the threads.
    """
    process = CameraProcess(way.driver)
    try:
        sink = Counting()
        cameras = [RemoteCamera(settings_by(way, each), process) for each in simulator.cameras]
        with ThreadPoolExecutor(len(cameras)) as calls:
            list(calls.map(RemoteCamera.open, cameras))
            list(calls.map(RemoteCamera.arm, cameras, [sink] * len(cameras)))
        assert process.pid is not None
        began_s = thread_cpu_s(process.pid)
        time.sleep(IDLE_S)
        idle_s, counted = thread_cpu_s(process.pid), simulator.ask({"do": "counters"})["cameras"]
        from_s = time.monotonic()
        simulator.ask({"do": "start"})
        time.sleep(seconds)
        simulator.ask({"do": "stop"})
        time.sleep(SETTLE_S)
        spent_s, lasted_s = thread_cpu_s(process.pid), time.monotonic() - from_s
        now = simulator.ask({"do": "counters"})["cameras"]
        sent, resent = (
            sum(now[each][name] - counted[each][name] for each in now) for name in ("exposures", "resent")
        )
        cores = {name: (idle_s[name] - began_s[name]) / IDLE_S for name in spent_s}
        more_s = {name: spent_s[name] - idle_s[name] - cores[name] * lasted_s for name in spent_s}
        return sent, sink.n_frames, resent, sum(cores.values()), more_s
    finally:
        process.close()


def settings_by(way: Receiving, camera: dict[str, str]) -> GigeCameraSettings:
    return GigeCameraSettings(
        id=CameraId(camera["id"]),
        address=camera["address"],
        interfaces=("127.0.0.1",),
        image_size_px=(1280, 1024),
        features=(*trigger_features(source="Line1", delay_us=0.0), *exposure_features(exposure_us=20.0)),
        packet_size_bytes=way.packet_bytes,
        receive_buffer_bytes=way.receive_buffer_bytes,
        n_buffers=way.n_buffers,
        may_be_simulated=True,
    )


if __name__ == "__main__":
    sys.exit(main())
