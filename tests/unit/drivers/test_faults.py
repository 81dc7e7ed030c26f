"""Each fault does what it says, seeded, to the devices it names and to no other."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from support.collector import Collector
from support.recordings import CAMERAS, make_bundle, tagged_image, write_recording

from drivers.factory import ReplayBackend, build_devices
from drivers.faults import Fault, FaultPlan
from drivers.interfaces import CameraLost, GateLost, PlaybackEnded, TriggersIgnored
from pipeline.frames import CameraId, Frame, Trigger

N_BUNDLES = 6
FIRST, SECOND = CAMERAS[0], CAMERAS[1]


def played(tmp_path: Path, plan: FaultPlan) -> Collector:
    """What arrives of six exposures; the frames of one camera are enough."""
    path = tmp_path / "recording"
    if not path.exists():
        write_recording(path, [make_bundle(i) for i in range(1, N_BUNDLES + 1)])
    devices = build_devices(ReplayBackend(recording=path, pace="fast", faults=plan))
    assert devices.belt is not None
    events = Collector()
    for camera in devices.cameras.values():
        camera.open()
        camera.arm(events)
    devices.gate.open()
    devices.gate.arm(events)
    devices.belt.permit(N_BUNDLES)
    events.wait(lambda: bool(events.of(PlaybackEnded) or events.of(GateLost)))
    devices.gate.close()
    for camera in devices.cameras.values():
        camera.close()
    return events


def shown(events: Collector, camera: CameraId = FIRST) -> list[int]:
    """Which exposures the camera's frames show, in the order they arrive."""
    numbers = []
    for frame in events.of(Frame):
        if frame.camera == camera:
            (number,) = (i for i in range(1, N_BUNDLES + 1) if (frame.image == tagged_image(i, camera)).all())
            numbers.append(number)
    return numbers


@pytest.mark.parametrize(
    ("plan", "expected"),
    [
        (FaultPlan(lose=Fault(at=frozenset({2}))), [1, 2, 4, 5, 6]),
        (FaultPlan(delay=Fault(at=frozenset({2}))), [1, 2, 3, 4, 5, 6]),
        (FaultPlan(duplicate=Fault(at=frozenset({2}))), [1, 2, 3, 3, 4, 5, 6]),
        (FaultPlan(swap=Fault(at=frozenset({2}))), [1, 2, 2, 4, 5, 6]),
        (FaultPlan(freeze=Fault(at=frozenset({2}))), [1, 2, 3, 3, 3, 3]),
    ],
    ids=["lose", "delay", "duplicate", "swap", "freeze"],
)
def test_frame_faults(tmp_path: Path, plan: FaultPlan, expected: Sequence[int]) -> None:
    events = played(tmp_path, replace(plan, cameras=frozenset({FIRST})))
    assert shown(events) == expected
    assert shown(events, SECOND) == [1, 2, 3, 4, 5, 6]


def test_a_delayed_frame_arrives_with_the_next_one(tmp_path: Path) -> None:
    plan = FaultPlan(delay=Fault(at=frozenset({2})), cameras=frozenset({FIRST}))
    frames = [frame for frame in played(tmp_path, plan).of(Frame) if frame.camera == FIRST]
    assert frames[2].received_ns == frames[3].received_ns
    assert frames[2].frame_id < frames[3].frame_id


def test_a_disconnected_camera_says_so_and_is_silent(tmp_path: Path) -> None:
    plan = FaultPlan(disconnect=Fault(at=frozenset({3})), cameras=frozenset({FIRST}))
    events = played(tmp_path, plan)
    assert shown(events) == [1, 2, 3]
    assert [lost.camera for lost in events.of(CameraLost)] == [FIRST]


def test_trigger_faults(tmp_path: Path) -> None:
    plan = FaultPlan(
        lose_trigger=Fault(at=frozenset({1})),
        double_trigger=Fault(at=frozenset({3})),
        bounce_trigger=Fault(at=frozenset({4})),
    )
    events = played(tmp_path, plan)
    names = [trigger.name for trigger in events.of(Trigger)]
    assert names == ["00000001", "00000003", "00000004", "00000004-double", "00000005", "00000006"]
    assert [ignored.count for ignored in events.of(TriggersIgnored)] == [1]
    assert shown(events) == [1, 2, 3, 4, 5, 6], "the cameras expose all the same"


def test_a_disconnected_gate_says_so_and_is_silent(tmp_path: Path) -> None:
    events = played(tmp_path, FaultPlan(disconnect_gate=Fault(at=frozenset({2}))))
    assert len(events.of(Trigger)) == 2
    assert len(events.of(GateLost)) == 1


def test_chance_is_seeded_and_independent_for_each_camera(tmp_path: Path) -> None:
    def survivors(seed: int) -> list[list[int]]:
        events = played(tmp_path, FaultPlan(seed=seed, lose=Fault(probability=0.5)))
        return [shown(events, camera) for camera in CAMERAS]

    first = survivors(1)
    assert survivors(1) == first
    assert survivors(2) != first
    assert len({tuple(numbers) for numbers in first}) > 1


def test_probabilities_are_checked() -> None:
    with pytest.raises(ValueError, match="probability"):
        Fault(probability=1.5)
