"""The simulated rig before the real drivers: what falls is what is delivered."""

import json
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.eventually import eventually
from support.recordings import CAMERAS, SIZE_PX, make_bundle, tagged_image, write_recording
from support.sinks import Collector

from drivers.cameras.aravis import AravisCamera
from drivers.cameras.genicam import GigeCameraSettings, exposure_features, trigger_features
from drivers.errors import CameraUnavailableError, GateUnavailableError
from drivers.files.recording import open_recording
from drivers.gates.firing import FiringGate
from drivers.gates.serial_gate import SerialGate, SerialGateSettings
from drivers.gige_simulator.rig import RigDesign, SimulatedRig
from drivers.interfaces import GateLost, LightGate, PulseEnded, TriggersLost
from pipeline.frames import BundleKind, CameraId, Frame, Image, Trigger

NET = f"127.32.{os.getpid() % 256}"
FIRST_ADDRESS = f"{NET}.2"
EXPOSURE_US = 20.0
FALL_MS = 50.0
"""A short fall: the tests shall be over soon."""
UNSEEN = CAMERAS[1]
"""Has no view of the stone in bundle 4."""


@pytest.fixture
def recording_path(tmp_path: Path) -> Path:
    bundles = [make_bundle(number, kind=BundleKind.BACKGROUND) for number in (1, 2)]
    bundles += [make_bundle(number) for number in (3, 5, 6)]
    return write_recording(tmp_path / "rec", [*bundles, make_bundle(4, missing={UNSEEN: "no frame"})])


@pytest.fixture
def design(tmp_path: Path) -> RigDesign:
    return RigDesign(
        gate_link=tmp_path / "gate",
        control=tmp_path / "control",
        first_address=FIRST_ADDRESS,
        rate_hz=10,
        fall_ms=FALL_MS,
        seed=1,
    )


@dataclass(frozen=True)
class Host:
    """The real drivers, armed."""

    gate: LightGate
    triggers: Collector
    frames: dict[CameraId, Collector]

    def images(self, camera: CameraId) -> list[Image]:
        return [event.image for event in self.frames[camera].events if isinstance(event, Frame)]


@contextmanager
def hosted(rig: SimulatedRig, design: RigDesign, *, source: str = "Line1") -> Iterator[Host]:
    delay_us = design.fall_ms * 1000
    with ExitStack() as stack:
        frames, cameras = {}, []
        for name, simulated in rig.cameras.items():
            camera = AravisCamera(
                GigeCameraSettings(
                    id=name,
                    address=simulated.design.address,
                    image_size_px=SIZE_PX,
                    features=(
                        *trigger_features(source=source, delay_us=delay_us),
                        *exposure_features(exposure_us=EXPOSURE_US),
                    ),
                    may_be_simulated=True,
                )
            )
            stack.callback(camera.close)
            camera.open()
            camera.arm(sink := Collector())
            frames[name] = sink
            cameras.append(camera)
        gate: LightGate = SerialGate(SerialGateSettings(port=str(design.gate_link)))
        if source == "Software":

            def fire() -> None:
                for camera in cameras:
                    camera.software_trigger()

            gate = FiringGate(gate, fire)
        stack.callback(gate.close)
        gate.open()
        gate.arm(triggers := Collector())
        yield Host(gate, triggers, frames)


@pytest.fixture
def ask(design: RigDesign) -> Callable[..., dict[str, Any]]:
    """One request to the control socket."""

    def request(**fields: Any) -> dict[str, Any]:
        with socket.socket(socket.AF_UNIX) as client, client.makefile("rw") as lines:
            client.connect(str(design.control))
            lines.write(json.dumps(fields) + "\n")
            lines.flush()
            answer: dict[str, Any] = json.loads(lines.readline())
            return answer

    return request


def expected_images(camera: CameraId) -> list[Image]:
    return [tagged_image(n, camera) for n in range(1, 7) if (n, camera) != (4, UNSEEN)]


@pytest.mark.full
def test_every_frame_is_the_recording_s_pixel_by_pixel(recording_path: Path, design: RigDesign) -> None:
    with SimulatedRig(design, open_recording(recording_path)) as rig, hosted(rig, design) as host:
        rig.belt.start_when(lambda: rig.is_ready)
        eventually(lambda: rig.is_over)
        for camera in CAMERAS:
            np.testing.assert_array_equal(host.images(camera), expected_images(camera))
        announced = [event for event in host.triggers.events if isinstance(event, Trigger)]
        assert [trigger.kind for trigger in announced] == [BundleKind.BACKGROUND] * 2 + [
            BundleKind.PARTICLE
        ] * 4
        assert [trigger.sequence for trigger in announced] == [1, 2, 3, 4, 5, 6]
        widths = [event.width_ns for event in host.triggers.events if isinstance(event, PulseEnded)]
        assert widths == pytest.approx([4_000_000] * 4, abs=2000)
        counters = rig.counters()
    assert (counters["belt"]["stones"], counters["belt"]["empty"]) == (4, 2)
    assert (counters["gate"]["edges"], counters["gate"]["test_pulses"]) == (4, 2)
    for camera in CAMERAS:
        counted = counters["cameras"][camera]
        assert (counted["edges"], counted["triggers"], counted["exposures"]) == (6, 6, 6)
        assert counted["frames"] == len(expected_images(camera))
        assert counted["unexposed"] == 6 - counted["frames"]


@pytest.mark.full
def test_without_a_wire_the_host_triggers(recording_path: Path, design: RigDesign) -> None:
    # a stone is seen as late as the host of a busy machine may be: less than the delay, which must not be left out
    design = replace(design, rate_hz=1, fall_ms=500, sight_ms=450)
    with (
        SimulatedRig(design, open_recording(recording_path)) as rig,
        hosted(rig, design, source="Software") as host,
    ):
        rig.belt.start_when(lambda: rig.is_ready)
        eventually(lambda: rig.is_over, 30)
        for camera in CAMERAS:
            np.testing.assert_array_equal(host.images(camera), expected_images(camera))
        assert rig.counters()["cameras"][CAMERAS[0]]["missed"] == 6  # edges on a line nobody listens to


@pytest.mark.full
def test_it_plays_again_and_again(recording_path: Path, design: RigDesign) -> None:
    looping = replace(design, is_looping=True, n_cameras=1)
    with SimulatedRig(looping, open_recording(recording_path)) as rig, hosted(rig, looping) as host:
        rig.belt.start()
        eventually(lambda: len(host.images(CAMERAS[0])) >= 15)
        np.testing.assert_array_equal(host.images(CAMERAS[0])[:12], expected_images(CAMERAS[0]) * 2)
        assert list(rig.cameras) == [CAMERAS[0]]


def test_a_test_pulse_shows_the_empty_rig(recording_path: Path, design: RigDesign) -> None:
    with SimulatedRig(design, open_recording(recording_path)) as rig, hosted(rig, design) as host:
        for n in (1, 2, 1):
            host.gate.test_pulse()
            for sink in host.frames.values():
                frame = sink.next()
                assert isinstance(frame, Frame)
                np.testing.assert_array_equal(frame.image, tagged_image(n, frame.camera))
        triggers = [event for event in host.triggers.events if isinstance(event, Trigger)]
        assert [trigger.kind for trigger in triggers] == [BundleKind.BACKGROUND] * 3
        assert rig.gate.counters.test_pulses == 3
        assert rig.belt.counters.empty == 0


@pytest.mark.parametrize("n_backgrounds", [0, 1])
def test_one_exposure_of_the_empty_rig_is_never_sent_twice(
    tmp_path: Path, design: RigDesign, n_backgrounds: int
) -> None:
    bundles = [make_bundle(number, kind=BundleKind.BACKGROUND) for number in range(1, n_backgrounds + 1)]
    recording = open_recording(write_recording(tmp_path / "rec", [*bundles, make_bundle(7)]))
    small = replace(design, n_cameras=1)
    with SimulatedRig(small, recording) as rig, hosted(rig, small) as host:
        for n in range(1, 4):
            host.gate.test_pulse()
            eventually(lambda n=n: len(host.images(CAMERAS[0])) == n)
        images = [image.astype(int) for image in host.images(CAMERAS[0])]
    for before, after in pairwise(images):
        assert 1 <= np.abs(after - before).sum() <= 2


def test_faults_by_socket(
    recording_path: Path, design: RigDesign, ask: Callable[..., dict[str, Any]]
) -> None:
    first, second = CAMERAS[0], CAMERAS[2]
    with SimulatedRig(design, open_recording(recording_path)) as rig, hosted(rig, design) as host:

        def drop(n_frames: int) -> None:
            assert ask(do="pulse")["ok"]
            eventually(lambda: len(host.images(second)) == n_frames)

        assert (
            ask(do="fault", of=first, set={"swallowed_frames": 1})["faults"][first]["swallowed_frames"] == 1
        )
        drop(1)
        assert ask(do="kill", of=first)["ok"]
        assert "killed" in ask(do="unplug", of="cameras")["problem"]
        drop(2)
        assert ask(do="revive", of=first)["ok"]
        assert not ask(do="state")["cameras"][first]["is_acquiring"]
        assert ask(do="fault", of="gate", set={"uncounted": 1})["ok"]
        drop(3)  # the first stone; before it fell nothing
        assert ask(do="fault", of="gate", clear=True)["faults"]["gate"]["uncounted"] == 0
        assert host.images(first) == []
        counters = ask(do="counters")
        assert counters["cameras"][first]["swallowed"] == 1
        assert counters["cameras"][first]["frames"] == 0
        assert counters["cameras"][second]["frames"] == 3
        assert counters["gate"]["uncounted"] == 1
        assert [event.kind for event in host.triggers.events if isinstance(event, Trigger)] == [
            BundleKind.BACKGROUND,
            BundleKind.BACKGROUND,
        ]
        ask(do="rate", hz=20)
        ask(do="start")
        eventually(lambda: ask(do="state")["belt"]["has_ended"])
        assert "--loop" in ask(do="pulse")["problem"]


def test_a_gate_whose_plug_is_pulled_counts_on(recording_path: Path, design: RigDesign) -> None:
    with SimulatedRig(design, open_recording(recording_path)) as rig, hosted(rig, design) as host:
        rig.gate.unplug()
        assert isinstance(host.triggers.next(), GateLost)
        rig.belt.drop_one()
        eventually(lambda: len(host.images(CAMERAS[0])) == 1)
        rig.gate.plug()
        eventually(design.gate_link.exists)
        host.gate.close()
        host.gate.open()
        host.gate.arm(sink := Collector())
        lost = sink.next()
        assert isinstance(lost, TriggersLost)
        assert lost.count == 1
        for sink in host.frames.values():
            assert sink.events


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        (b"{", "Expecting"),
        (b"[]", "object"),
        (b"{}", "do: must be one of help"),
        (b'{"do": "fault"}', "missing a required argument: 'of'"),
        (b'{"do": "fault", "of": "c09"}', "of: must be one of c01 or cameras, not 'c09'"),
        (b'{"do": "fault", "of": "gate", "set": {"packet_loss": 1}}', "there is no fault 'packet_loss'"),
        (b'{"do": "fault", "of": "c01", "set": 3}', "set: "),
        (b'{"do": "unplug", "of": "c01", "seconds": -1}', "seconds: "),
        (b'{"do": "power_cycle", "of": "cameras", "serial": "X"}', "of: name one camera"),
        (b'{"do": "power_cycle", "of": "c01", "address": "127.32"}', "127.32"),
        (b'{"do": "tamper", "of": "c01", "feature": "Colour", "value": 1}', "Colour"),
        (b'{"do": "send_malformed", "of": "c01", "kind": "odd"}', "kind: must be one of short"),
        (b'{"do": "rate", "hz": "fast"}', "hz: "),
        (b'{"do": "jump_clock", "of": "c01", "ms": "x"}', "jump_clock: "),
    ],
)
def test_a_wrong_request_is_explained(
    recording_path: Path, design: RigDesign, line: bytes, problem: str
) -> None:
    with (
        SimulatedRig(replace(design, n_cameras=1), open_recording(recording_path)),
        socket.socket(socket.AF_UNIX) as client,
        client.makefile("rb") as answers,
    ):
        client.connect(str(design.control))
        client.sendall(line + b"\n" + b'{"do": "state"}\n')
        answer = json.loads(answers.readline())
        assert answer["ok"] is False
        assert problem in answer["problem"]
        assert json.loads(answers.readline())["ok"] is True


def test_what_is_in_the_way_is_named(recording_path: Path, design: RigDesign) -> None:
    recording = open_recording(recording_path)
    with SimulatedRig(design, recording):
        with pytest.raises(CameraUnavailableError, match=FIRST_ADDRESS):
            SimulatedRig(design, recording).open()
        elsewhere = replace(design, first_address=f"{NET}.100")
        with pytest.raises(OSError, match=str(design.control)):
            SimulatedRig(elsewhere, recording).open()
    design.gate_link.write_text("a file of somebody")
    with pytest.raises(GateUnavailableError, match=str(design.gate_link)):
        SimulatedRig(design, recording).open()
    assert design.gate_link.read_text() == "a file of somebody"
