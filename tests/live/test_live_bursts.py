"""Two stones 25 ms apart through sixteen cameras behind one uplink: nothing is lost, or health says what is.

Images and the uplink of 20 Gb/s are a sixteenth of real ones; packets are smaller by as much as keeps their number.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.daemon_process import DaemonProcess
from support.live_rig import LiveRig, eventually, live_section, simulated_rig
from support.small_recording import SHRINK, write_small_recording

from service.configuration.camera_wire import BUFFER_BYTES, BURST_MS, CameraWire, carried

WIRE = CameraWire(
    n_cameras=16,
    image_bytes=1280 * 1024 // SHRINK**2,
    uplink_bytes_s=2.5e9 / SHRINK**2,
    packet_bytes=1500,
)
"""As the switch is; a camera may send as fast as its link takes it."""
PULSE_MS = 5.0
"""Time (ms) for which a stone that is already falling closes the beam: it is open again when the next one comes."""
SPACING_S = BURST_MS / 1e3 + 0.004
N_TRIES = 15
"""A machine on which other tests run may lose a stone, as its frames come too late, but not in each try."""


@contextmanager
def rig_behind(wire: CameraWire, folder: Path, number: int) -> Iterator[LiveRig]:
    """A daemon whose cameras send as `wire` says; it does not know how slow the uplink is, or it would refuse."""
    recording = folder / "recording"
    write_small_recording(recording, n_stones=4, pulse_ms=PULSE_MS)
    more = f"""delay = "gate"
packet_size_bytes = {wire.packet_bytes}
packet_delay_ns = {wire.packet_delay_ns}
[bundling]
dead_time_ms = {BURST_MS}"""
    with simulated_rig(
        folder,
        recording,
        number=number,
        only_stones=True,
        uplink_bytes_s=wire.uplink_bytes_s,
        uplink_buffer_bytes=wire.buffer_bytes,
    ) as rig:
        section = live_section(rig, folder, recording, more=more, by_address=True)
        with DaemonProcess(folder, recording, rig=section) as daemon:
            daemon.hear("READY=1")
            live = LiveRig(rig, daemon)
            live.wait_until_whole()
            yield live


def burst(live: LiveRig) -> list[dict[str, Any]]:
    """Let two stones fall one after the other; return their outcomes."""
    before, fell = live.last_seq(), live.stones
    live.rig.belt.drop_one()
    threading.Event().wait(SPACING_S)
    live.rig.belt.drop_one()
    eventually(lambda: live.stones == fell + 2, "both fell")
    return live.wait_for_results(before, 2)


def dropped(live: LiveRig) -> int:
    return sum(camera.counters.dropped for camera in live.rig.cameras.values())


def assert_accounted(live: LiveRig, n_stones: int) -> None:
    counts = live.accounting()
    assert counts["is_balanced"], counts
    assert counts["triggers"] == live.stones == n_stones
    assert counts["triggers"] == counts["measured"] + counts["rejected"] + counts["lost"]


@pytest.mark.full
def test_of_two_stones_in_a_burst_none_is_lost(tmp_path: Path) -> None:
    wire = WIRE.paced()
    assert carried(wire, 10).is_burst_carried
    with rig_behind(wire, tmp_path, 14) as live:
        for _ in range(N_TRIES):
            results = burst(live)
            if all(len(result["views"]) == 16 for result in results):
                break
        assert [(result["outcome"], len(result["views"])) for result in results] == [("measured", 16)] * 2
        assert_accounted(live, len(live.results(0)))
        assert dropped(live) == 0


@pytest.mark.full
def test_what_a_network_that_is_too_narrow_loses_is_told(tmp_path: Path) -> None:
    """Without a packet delay the switch is overrun, as check-config says; cameras resend nothing, as some do not."""
    wire = replace(WIRE, buffer_bytes=BUFFER_BYTES // SHRINK**2)
    assert not carried(wire, 10).is_carried
    with rig_behind(wire, tmp_path, 15) as live:
        for camera in live.rig.cameras.values():
            camera.faults.set("no_resend", True)
        cameras = {f"camera:{camera}" for camera in live.rig.cameras}
        results: list[dict[str, Any]] = []
        told: set[str] = set()
        while not told & cameras:
            assert len(results) < 2 * N_TRIES, (
                f"never told: {[(r['outcome'], r['dropped_views']) for r in results]}"
            )
            results += burst(live)
            health = live.daemon.get("/health")
            told = {name for name, check in health["checks"].items() if check["status"] != "pass"}
        assert health["ne107"] != "good"
        assert_accounted(live, len(results))
        assert dropped(live) > 0
        assert all(len(result["views"]) < 16 for result in results)
        eventually(
            lambda: sum(camera["failed_frames"] for camera in live.daemon.get("/cameras")["items"]) > 0,
            "the drivers count what came in part",
        )
