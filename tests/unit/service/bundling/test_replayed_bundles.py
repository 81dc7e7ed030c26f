"""A recording through replay, inbox and assembler: the way of a real rig, and the same bundles at its end."""

import asyncio
from pathlib import Path

import numpy as np
import pytest
from support.recordings import CAMERAS, make_bundle, tagged_image, write_recording

from drivers.factory import Devices, ReplayBackend, build_devices
from drivers.faulty.faults import Fault, FaultPlan
from drivers.inbox import EventInbox
from drivers.interfaces import PlaybackEnded
from drivers.replay.belt import Pace
from pipeline.frames import BundleKind, FrameBundle
from service.bundling.assembler import BundleAssembler
from service.bundling.window import BundlingParameters


async def pump(devices: Devices, n_in_flight: int = 2) -> tuple[list[FrameBundle], BundleAssembler]:
    """Everything the rig sees, with as many permits as bundles may be under way."""
    inbox = EventInbox(asyncio.get_running_loop(), capacity=200)
    assembler = BundleAssembler(CAMERAS, BundlingParameters())
    for device in (*devices.cameras.values(), devices.gate):
        device.open()
        device.arm(inbox)
    belt = devices.belt
    assert belt is not None
    belt.permit(n_in_flight)
    bundles: list[FrameBundle] = []
    event = None
    while not isinstance(event, PlaybackEnded):
        now_ns = devices.clock()
        event = await inbox.get(timeout_s=0.02)
        finished = assembler.advance(now_ns) if event is None else assembler.feed(event)
        bundles += finished
        belt.permit(len(finished))
    for device in (devices.gate, *devices.cameras.values()):
        await asyncio.to_thread(device.close)
    assert inbox.refused == {}
    return bundles, assembler


@pytest.mark.parametrize(("pace", "speed"), [("fast", 1.0), ("recorded", 5.0)])
async def test_what_was_recorded_comes_back(tmp_path: Path, pace: Pace, speed: float) -> None:
    recorded = [
        make_bundle(0, kind=BundleKind.BACKGROUND),
        make_bundle(1),
        make_bundle(2, missing={CAMERAS[0]: "no_image", CAMERAS[2]: "no_frame"}),
        make_bundle(3),
        make_bundle(4, kind=BundleKind.BALL, name="ball"),
    ]
    path = write_recording(tmp_path / "rec", recorded)
    torn = path / "bundles" / "00000003.tiff"
    torn.write_bytes(torn.read_bytes()[:-2000])
    bundles, assembler = await pump(build_devices(ReplayBackend(recording=path, pace=pace, speed=speed)))
    assert [(b.name, b.kind) for b in bundles] == [(b.name, b.kind) for b in recorded]
    missing = [{}, {}, {CAMERAS[0]: "no_image", CAMERAS[2]: "no_frame"}, {CAMERAS[3]: "damaged"}, {}]
    assert [dict(bundle.missing) for bundle in bundles] == missing
    for number, bundle in enumerate(bundles):
        for camera, frame in bundle.frames.items():
            assert np.array_equal(frame.image, tagged_image(number, camera))
    assert all(
        (counters.not_exposed, counters.unannounced, counters.id_restarts) == (0, 0, 0)
        for counters in assembler.counters.cameras.values()
    )


@pytest.mark.parametrize("n_in_flight", [1, 4])
@pytest.mark.parametrize("seed", range(4))
async def test_faults_cost_views_and_never_mix_stones(tmp_path: Path, seed: int, n_in_flight: int) -> None:
    n_bundles = 30
    path = write_recording(tmp_path / "rec", [make_bundle(number) for number in range(n_bundles)])
    some = Fault(probability=0.05)
    plan = FaultPlan(
        seed=seed,
        lose=some,
        delay=some,
        duplicate=some,
        disconnect=Fault(probability=0.003),
        lose_trigger=some,
        double_trigger=some,
        bounce_trigger=some,
    )
    bundles, assembler = await pump(
        build_devices(ReplayBackend(recording=path, pace="fast", faults=plan)), n_in_flight
    )
    counters = assembler.counters
    assert len(bundles) == counters.triggers == counters.complete + counters.incomplete
    orphans = [bundle for bundle in bundles if not bundle.trigger.is_announced]
    assert len(orphans) == counters.orphans > 0
    announced = {int(bundle.name.split("-")[0]) for bundle in bundles if bundle.trigger.is_announced}
    for orphan in orphans:
        shown = [
            number
            for number in set(range(n_bundles)) - announced
            if all(
                np.array_equal(each.image, tagged_image(number, each.camera))
                for each in orphan.frames.values()
            )
        ]
        assert len(shown) == 1
    bundles = [bundle for bundle in bundles if bundle.trigger.is_announced]
    originals = [bundle for bundle in bundles if not bundle.name.endswith("-double")]
    assert len(bundles) - len(originals) == counters.in_dead_time
    assert len({bundle.name for bundle in bundles}) == len(bundles)
    assert n_bundles * 0.7 < len(originals) < n_bundles
    n_wrong = 0
    for bundle in bundles:
        assert set(bundle.frames) | set(bundle.missing) == set(CAMERAS)
        number = int(bundle.name.split("-")[0])
        n_wrong += sum(
            not np.array_equal(frame.image, tagged_image(number, camera))
            for camera, frame in bundle.frames.items()
        )
    assert n_wrong == 0
    assert counters.complete > 0
    assert counters.incomplete > 0
