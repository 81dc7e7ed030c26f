"""What is measured of real packets is what the replay backend measures of the same recording, bit for bit.

One recording with what the fault table wants rejected, played by the replay backend and by a simulated rig to the
real drivers, on a network that loses every hundredth packet: as fast as cameras take stones that wait for each, and ten
a second, up to three in the air together, where the gate makes the delay.
"""

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
from support.daemon_process import DaemonProcess
from support.live_rig import LiveRig, eventually, live_rig, live_section, simulated_rig
from support.small_recording import write_odd_recording, write_small_recording
from support.stores import folder_of

from drivers.files.recording import Recording, open_recording, playback_order, read_bundle
from pipeline.frames import BundleKind
from service.results.fields import MEASURED_FIELDS

COMPARED = (
    "kind", "outcome", "reason", "detail", "quality", "views", "dropped_views", *MEASURED_FIELDS,
    "view_residuals_px", "gate_extent_is_plausible", "calibration_id", "algorithm_version", "is_simulated",
)  # fmt: skip
REASONS = [None, "empty", None, "multiple", None, "clipped", None]
"""Of the recording's stones, in the order in which they fall."""
PACKET_LOSS = 0.01


@dataclass(frozen=True)
class Run:
    """What a daemon made of the recording; it may still run."""

    daemon: DaemonProcess
    results: list[dict[str, Any]]

    def kept(self, result: dict[str, Any]) -> dict[str, bytes]:
        """Return mesh and silhouettes of a stone, by file name."""
        folder = self.folder_of(result)
        return {
            path.name: path.read_bytes() for path in folder.iterdir() if path.stem in ("mesh", "silhouettes")
        }

    def folder_of(self, result: dict[str, Any]) -> Path:
        return folder_of(self.daemon.folder / "state", result["id"])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("recorded") / "recording"
    write_odd_recording(path)
    return open_recording(path)


@pytest.fixture(scope="module")
def spheres(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("spheres") / "recording"
    write_small_recording(path, n_stones=4, n_backgrounds=3)
    return path


@pytest.fixture(scope="module")
def replayed(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Run:
    with DaemonProcess(tmp_path_factory.mktemp("replayed"), recording.path) as daemon:
        daemon.hear("READY=1")
        return Run(daemon, all_results(daemon))


@pytest.fixture(scope="module", params=[("camera", 4.0), ("gate", 10.0)], ids=["cameras wait", "in the air"])
def live(
    request: pytest.FixtureRequest, recording: Recording, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[Run, LiveRig]]:
    folder, (delay, rate_hz) = tmp_path_factory.mktemp("live"), request.param
    with simulated_rig(folder, recording.path, rate_hz=rate_hz, is_looping=False, number=2) as rig:
        for camera in rig.cameras.values():
            camera.faults.packet_loss = PACKET_LOSS
        more = f'delay = "{delay}"'
        section = live_section(rig, folder, recording.path, more=more, by_address=True, at_start=0)
        with DaemonProcess(folder, recording.path, rig=section) as daemon:
            daemon.hear("READY=1")
            live = LiveRig(rig, daemon)
            live.wait_until_whole()
            rig.belt.start()
            yield Run(daemon, all_results(daemon)), live


def all_results(daemon: DaemonProcess) -> list[dict[str, Any]]:
    daemon.wait_for(
        "/accounting", lambda now: now["triggers"] == len(REASONS) and now["in_progress"] == now["lost"] == 0
    )
    return daemon.results()


def test_outcomes_and_measured_numbers_are_equal(replayed: Run, live: tuple[Run, LiveRig]) -> None:
    run, _ = live
    assert [result["reason"] for result in replayed.results] == REASONS
    for ours, theirs in zip(run.results, replayed.results, strict=True):
        assert {key: ours[key] for key in COMPARED} == {key: theirs[key] for key in COMPARED}
        if (
            theirs["reason"] != "empty"
        ):  # the gate's line tells the width in whole microseconds of its own clock
            assert ours["gate_extent_mm"] == pytest.approx(theirs["gate_extent_mm"], rel=1e-3)
    assert all(len(result["views"]) == 16 for result in run.results if result["outcome"] == "measured")


def test_meshes_and_silhouettes_are_equal(replayed: Run, live: tuple[Run, LiveRig]) -> None:
    run, _ = live
    for ours, theirs in zip(run.results, replayed.results, strict=True):
        kept = run.kept(ours)
        assert kept == replayed.kept(theirs)
        assert len(kept) == 1 + (ours["outcome"] == "measured")


def test_the_frames_kept_are_the_recording_pixel_by_pixel(
    recording: Recording, live: tuple[Run, LiveRig]
) -> None:
    run, _ = live
    stones = [header for header in playback_order(recording) if header.kind is not BundleKind.BACKGROUND]
    archived = [run.folder_of(result) / "bundle.tiff" for result in run.results]
    eventually(archived[0].exists, "the first frames kept")  # later ones may be left out on a busy machine
    with httpx.Client() as client:
        for header, result, archive in zip(stones, run.results, archived, strict=True):
            if not archive.exists():
                continue
            for camera, frame in read_bundle(header.path, recording.camera_ids).frames.items():
                url = run.daemon.url(f"/particles/{result['id']}/views/{camera}.png")
                png = client.get(url).raise_for_status().content
                seen = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
                assert np.array_equal(seen, frame.image), (header.name, camera)


def test_every_trigger_has_an_outcome_and_the_drivers_count_what_the_cameras_count(
    live: tuple[Run, LiveRig],
) -> None:
    run, rig = live
    counts = run.daemon.get("/accounting")
    assert counts["is_balanced"], counts
    assert counts["triggers"] == rig.stones == counts["measured"] + counts["rejected"] + counts["lost"]
    assert (counts["lost"], counts["backgrounds"]) == (0, 2)
    assert {key: counts["by_reason"][key] for key in ("empty", "multiple", "clipped")} == Counter(
        REASONS[1::2]
    )

    def told(key: str) -> dict[str, int]:
        return {camera["id"]: camera[key] for camera in run.daemon.get("/cameras")["items"]}

    counters = {camera.id: camera.counters for camera in rig.rig.cameras.values()}
    assert told("frames") == {camera: each.frames for camera, each in counters.items()}
    # a busy machine asks again for what is only late, and the driver counts no packet twice
    n_dropped = sum(each.dropped for each in counters.values())
    n_resent = sum(each.resent for each in counters.values())
    eventually(  # each camera is asked every few seconds
        lambda: 0.9 * n_dropped <= sum(told("resent_packets").values()) <= n_resent,
        f"{counters}",
    )
    assert told("failed_frames") == {camera: each.torn for camera, each in counters.items()}
    assert n_resent > 0
    assert run.daemon.get("/acquisition")["triggers"] == len(REASONS) + 2


@pytest.mark.full
@pytest.mark.parametrize("trigger", ["software", "action"])
def test_without_a_wire_the_host_triggers_and_the_cameras_do_the_timing(
    tmp_path: Path, spheres: Path, trigger: str
) -> None:
    """What is exposed without the delay, or before the trigger, shows the empty rig.

    A stone is seen, and its frames are waited for, as late as a busy machine may be: less than the delay.
    """
    late_ms = 200
    more = f"""trigger = "{trigger}"
[rig.action]
device_key = {os.getpid()}  # of no other rig on this machine
[bundling]
window_ms = {late_ms}
dead_time_ms = 500"""
    with live_rig(tmp_path, spheres, more=more, by_address=True, sight_ms=late_ms, number=3) as live:
        before = live.last_seq()
        live.fall(4, spacing_s=0.7)  # more than the dead time and what the host is late
        results = live.wait_for_results(before, 4)
        assert [(result["outcome"], len(result["views"])) for result in results] == [("measured", 16)] * 4
        n_fired = live.accounting()["backgrounds"] + 4
        for camera in live.rig.cameras.values():
            assert camera.counters.frames == camera.counters.triggers == n_fired == 2 + 3 + 4
            assert camera.counters.actions == (n_fired if trigger == "action" else 0)
