"""What the gate tells late or not at all is named for a minute; the time is the test's."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.interfaces import TriggersLost
from pipeline.frames import CameraId, Frame, FrameBundle, Trigger
from service.acquisition.gate_watch import EARLY_STONES, RECENT_S, GateWatch
from service.bundling.window import BundlingParameters

PARAMETERS = BundlingParameters()
CAMERA = CameraId("c01")
MS = 1_000_000


def bundle(*, is_announced: bool = True, early_ms: float = 0.0, has_frame: bool = True) -> FrameBundle:
    trigger = Trigger(sequence=1, received_ns=0, device_ns=0, utc="", is_announced=is_announced)
    frame = Frame(
        camera=CAMERA,
        image=np.zeros((1, 1), np.uint8),
        frame_id=1,
        device_ns=0,
        received_ns=round((PARAMETERS.expected_delay_ms - early_ms) * MS),
    )
    missing = {} if has_frame else {CAMERA: "unseen"}
    return FrameBundle(trigger=trigger, frames={CAMERA: frame} if has_frame else {}, missing=missing)


def gap(count: int) -> TriggersLost:
    return TriggersLost(received_ns=0, count=count, reason="counted by the gate, not announced")


@pytest.fixture
def watch() -> GateWatch:
    return GateWatch(PARAMETERS)


def test_a_gate_that_announces_its_stones_in_time_is_not_warned_of(watch: GateWatch) -> None:
    for second in range(100):
        watch.note_bundle(bundle(early_ms=12), second)
    assert watch.warnings(100) == ()


def test_a_silent_gate_is_named_and_no_longer_when_it_speaks(watch: GateWatch) -> None:
    watch.note_bundle(bundle(is_announced=False), 1)
    (warning,) = watch.warnings(1)
    assert warning.startswith("1 stones within the last minute were not announced")
    for second in (2, 3):
        watch.note_bundle(bundle(is_announced=False), second)
    (warning,) = watch.warnings(3)
    assert warning.startswith("the cameras expose and the gate says nothing, 3 stones in a row")
    watch.note_bundle(bundle(), 4)
    (warning,) = watch.warnings(4)
    assert warning.startswith("3 stones within the last minute were not announced")
    assert watch.warnings(3 + RECENT_S + 1) == ()


def test_stones_that_only_the_counter_knows_are_no_sign_of_a_silent_gate(watch: GateWatch) -> None:
    watch.note_gap(gap(500), 1)
    for _ in range(500):
        watch.note_bundle(bundle(is_announced=False, has_frame=False), 1)
    (warning,) = watch.warnings(2)
    assert warning.startswith("its counter went on by 500 stones without their lines within the last minute")
    assert watch.warnings(1 + RECENT_S + 1) == ()


def test_edges_that_this_machine_missed_are_no_fault_of_the_gate(watch: GateWatch) -> None:
    watch.note_gap(replace(gap(2), reason="3 edges dropped by the kernel", by_host=True), 1)
    (warning,) = watch.warnings(2)
    assert warning.startswith(
        "this machine missed the edges of 2 stones on its line within the last minute (3 edges"
    )
    assert warning.endswith("look at the load of this machine")
    watch.note_gap(gap(1), 2)
    assert len(watch.warnings(2)) == 2
    assert watch.warnings(2 + RECENT_S + 1) == ()


def test_announcements_that_come_late_are_told_from_missing_ones(watch: GateWatch) -> None:
    for second in range(5):
        watch.note_bundle(bundle(is_announced=False), second)
        watch.note_late(second + 0.5)
    (warning,) = watch.warnings(5)
    assert warning.startswith("5 announcements within the last minute came too late for their frames")
    assert watch.warnings(5 + RECENT_S + 1) == ()


def test_a_constant_lag_of_the_lines_shows_in_frames_that_come_early(watch: GateWatch) -> None:
    for second in range(EARLY_STONES):
        assert watch.warnings(second) == ()
        watch.note_bundle(bundle(early_ms=60), second)
    (warning,) = watch.warnings(5)
    assert warning.startswith("frames come 60 ms before they are expected: the gate's lines arrive late")
    for second in range(EARLY_STONES):
        watch.note_bundle(bundle(early_ms=5), second)
    assert watch.warnings(10) == ()
