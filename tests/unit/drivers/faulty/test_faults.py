from dataclasses import replace
from typing import Any

import pytest
from support.recordings import CAMERAS, SPACING_NS, make_bundle, tagged_image
from support.sinks import Collector

from drivers.faulty.camera import FaultyCamera
from drivers.faulty.faults import Dice, Fault, FaultPlan
from drivers.faulty.gate import FaultyGate
from drivers.interfaces import CameraLost, DeviceEvent, EventSink, GateLost, TriggersIgnored
from pipeline.frames import CameraId, Frame, Trigger

C01, C02 = CAMERAS[:2]
FRAMES = [make_bundle(number).frames[C01] for number in range(8)]
TRIGGERS = [make_bundle(number, name=f"n{number}").trigger for number in range(8)]


class Puppet:
    """A camera or gate that delivers what the test says."""

    id = C01

    def __init__(self) -> None:
        self.sink: EventSink | None = None

    def open(self) -> None: ...

    def arm(self, sink: EventSink) -> None:
        self.sink = sink

    def disarm(self) -> None:
        self.sink = None

    def close(self) -> None:
        self.sink = None

    def say(self, events: list[Any]) -> None:
        assert self.sink is not None
        for event in events:
            self.sink.deliver(event)


def at(*indices: int) -> Fault:
    return Fault(at=frozenset(indices))


def through_camera(plan: FaultPlan, events: list[Any] = FRAMES) -> list[DeviceEvent]:
    puppet, sink = Puppet(), Collector()
    camera = FaultyCamera(puppet, plan)
    camera.open()
    camera.arm(sink)
    puppet.say(events)
    return sink.events


def through_gate(plan: FaultPlan) -> list[DeviceEvent]:
    puppet, sink = Puppet(), Collector()
    gate = FaultyGate(puppet, plan)
    gate.open()
    gate.arm(sink)
    puppet.say(TRIGGERS)
    return sink.events


def ids(events: list[DeviceEvent]) -> list[int]:
    return [event.frame_id - 1 for event in events if isinstance(event, Frame)]


def shown(events: list[DeviceEvent]) -> list[int]:
    """Whose exposure each frame shows."""
    tags = {tagged_image(number, C01).tobytes(): number for number in range(8)}
    return [tags[event.image.tobytes()] for event in events if isinstance(event, Frame)]


def test_without_faults_nothing_changes() -> None:
    assert through_camera(FaultPlan()) == FRAMES
    assert through_gate(FaultPlan()) == TRIGGERS
    assert through_camera(FaultPlan(cameras=frozenset({C02}), lose=Fault(probability=1))) == FRAMES


def test_a_frame_is_lost() -> None:
    assert ids(through_camera(FaultPlan(lose=at(2, 5)))) == [0, 1, 3, 4, 6, 7]


def test_a_frame_is_late() -> None:
    events = through_camera(FaultPlan(delay=at(2, 3)))
    assert ids(events) == [0, 1, 2, 3, 4, 5, 6, 7]
    arrivals_ns = [event.received_ns - FRAMES[0].received_ns for event in events]
    assert arrivals_ns == [SPACING_NS * number for number in (0, 1, 4, 4, 4, 5, 6, 7)]
    assert [event.device_ns for event in events if isinstance(event, Frame)] == [f.device_ns for f in FRAMES]


def test_a_frame_comes_twice() -> None:
    assert ids(through_camera(FaultPlan(duplicate=at(1)))) == [0, 1, 1, 2, 3, 4, 5, 6, 7]


def test_a_frame_shows_the_stone_before() -> None:
    events = through_camera(FaultPlan(swap=at(0, 3)))
    assert ids(events) == list(range(8))
    assert shown(events) == [0, 1, 2, 2, 4, 5, 6, 7]


def test_a_camera_freezes() -> None:
    events = through_camera(FaultPlan(freeze=at(3)))
    assert ids(events) == list(range(8))
    assert shown(events) == [0, 1, 2, 3, 3, 3, 3, 3]


def test_a_camera_is_gone_until_it_is_opened_again() -> None:
    puppet, sink = Puppet(), Collector()
    camera = FaultyCamera(puppet, FaultPlan(disconnect=at(2)))
    camera.open()
    camera.arm(sink)
    puppet.say(FRAMES[:4])
    assert ids(sink.events) == [0, 1]
    (loss,) = sink.events[2:]
    assert isinstance(loss, CameraLost)
    assert loss.camera == C01
    camera.close()
    camera.open()
    camera.arm(sink)
    puppet.say(FRAMES[4:])
    assert ids(sink.events) == [0, 1, 4, 5, 6, 7]


def test_delayed_frames_do_not_survive_disarming() -> None:
    puppet, sink = Puppet(), Collector()
    camera = FaultyCamera(puppet, FaultPlan(delay=at(0)))
    camera.open()
    camera.arm(sink)
    puppet.say(FRAMES[:1])
    camera.disarm()
    camera.arm(sink)
    puppet.say(FRAMES[1:2])
    assert ids(sink.events) == [1]


def test_a_trigger_is_lost() -> None:
    swallowed: list[int] = []
    puppet, sink = Puppet(), Collector()
    gate = FaultyGate(puppet, FaultPlan(lose_trigger=at(2)), on_swallowed=lambda: swallowed.append(1))
    gate.open()
    gate.arm(sink)
    puppet.say(TRIGGERS)
    assert [event.sequence for event in sink.events if isinstance(event, Trigger)] == [0, 1, 3, 4, 5, 6, 7]
    assert swallowed == [1]


def test_a_stone_is_counted_twice() -> None:
    events = through_gate(FaultPlan(double_trigger=at(1)))
    assert [(event.sequence, event.name) for event in events if isinstance(event, Trigger)] == [
        (0, "n0"),
        (1, "n1"),
        (2, "n1-double"),
        *((number + 1, f"n{number}") for number in range(2, 8)),
    ]
    assert 0 < events[2].received_ns - events[1].received_ns < SPACING_NS / 10


def test_an_edge_bounces() -> None:
    events = through_gate(FaultPlan(bounce_trigger=at(1)))
    assert [event for event in events if isinstance(event, Trigger)] == TRIGGERS
    (bounce,) = (event for event in events if isinstance(event, TriggersIgnored))
    assert (bounce.count, bounce.reason) == (1, "bounce")


def test_the_gate_is_gone_until_it_is_opened_again() -> None:
    puppet, sink = Puppet(), Collector()
    gate = FaultyGate(puppet, FaultPlan(disconnect_gate=at(1)))
    gate.open()
    gate.arm(sink)
    puppet.say(TRIGGERS[:4])
    assert [type(event) for event in sink.events] == [Trigger, GateLost]
    gate.close()
    gate.open()
    gate.arm(sink)
    puppet.say(TRIGGERS[4:])
    assert sink.events[2:] == TRIGGERS[4:]


def test_the_seed_decides() -> None:
    plan = FaultPlan(seed=3, lose=Fault(probability=0.5))
    outcomes = {tuple(ids(through_camera(replace(plan, seed=seed)))) for seed in range(10)}
    assert len(outcomes) > 5
    assert through_camera(plan) == through_camera(plan)
    # another fault in the plan does not move the first one
    both = through_camera(replace(plan, duplicate=Fault(probability=0.5)))
    assert sorted(set(ids(both))) == ids(through_camera(plan))


def test_chance_strikes_each_camera_on_its_own() -> None:
    def strikes(camera: CameraId) -> tuple[bool, ...]:
        dice = Dice(1, camera)
        return tuple(dice.strikes(Fault(probability=0.5), index) for index in range(32))

    assert strikes(C01) == strikes(C01)
    assert len({strikes(camera) for camera in CAMERAS}) == len(CAMERAS)


def test_wrong_plans_are_named() -> None:
    with pytest.raises(ValueError, match=r"probability must be in 0\.\.1"):
        Fault(probability=1.5)
