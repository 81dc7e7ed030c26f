"""What falls in the simulated rig, when, and what is seen of it."""

import threading
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.eventually import PATIENCE_S, eventually
from support.recordings import CAMERAS, make_bundle, tagged_image, write_recording

from drivers.files.recording import BundleHeader, Recording, open_recording
from drivers.gige_simulator.belt import Belt
from drivers.gige_simulator.camera import Exposure
from drivers.gige_simulator.hopper import PULSE_WIDTH_NS, Drop, Hopper, read_fall
from drivers.gige_simulator.sources import SIGHT_MS, Scene
from pipeline.frames import BundleKind, CameraId, Image

CAMERA = CAMERAS[0]
FALL_NS = 250_000_000
EXPOSURE = Exposure(camera=CAMERA, n=1, trigger_ns=0, exposed_ns=0, exposure_us=20.0, gain_db=0.0)


@pytest.fixture
def recording_path(tmp_path: Path) -> Path:
    stones = [make_bundle(number) for number in (1, 3)]
    return write_recording(tmp_path / "rec", [*stones, make_bundle(2, kind=BundleKind.BACKGROUND)])


def taken(hopper: Hopper, n: int) -> list[Drop | None]:
    hopper.start()
    falls = [hopper.take() for _ in range(n)]
    hopper.close()
    return falls


def shows(fall: Drop | None, number: int) -> bool:
    return fall is not None and np.array_equal(fall.images[CAMERA], tagged_image(number, CAMERA))


class TestHopper:
    def test_in_playback_order(self, recording_path: Path) -> None:
        falls = taken(Hopper(open_recording(recording_path)), 4)
        assert all(shows(fall, number) for fall, number in zip(falls, (2, 1, 3), strict=False))
        assert [fall and fall.is_empty for fall in falls] == [True, False, False, None]
        assert falls[1] is not None
        assert falls[1].pulse_width_ns == 4_000_000

    def test_in_a_loop(self, recording_path: Path) -> None:
        falls = taken(Hopper(open_recording(recording_path), is_looping=True), 7)
        assert all(shows(fall, number) for fall, number in zip(falls, (2, 1, 3, 2, 1, 3, 2), strict=True))
        assert falls[0] is falls[3]

    def test_what_cannot_be_read_falls_unseen(self, recording_path: Path) -> None:
        paths = open_recording(recording_path).headers
        paths[0].path.write_bytes(b"torn")
        recording = open_recording(recording_path)
        paths[2].path.unlink()
        falls = taken(Hopper(recording), 4)
        assert [fall and len(fall.images) for fall in falls] == [len(CAMERAS), 0, 0, None]

    def test_a_width_where_none_was_recorded(self, tmp_path: Path) -> None:
        bundle = make_bundle(1)
        bundle = replace(bundle, trigger=replace(bundle.trigger, pulse_width_ns=None))
        (fall,) = taken(Hopper(open_recording(write_recording(tmp_path / "rec", [bundle]))), 1)
        assert fall is not None
        assert fall.pulse_width_ns == PULSE_WIDTH_NS

    def test_all_is_unpacked_before_the_first_one_falls(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Later the cameras need the processor."""
        unpacked = []

        def unpack(header: BundleHeader, recording: Recording) -> Drop:
            unpacked.append(header.name)
            return read_fall(header, recording)

        monkeypatch.setattr("drivers.gige_simulator.hopper.read_fall", unpack)
        path = write_recording(tmp_path / "rec", [make_bundle(number) for number in range(1, 9)])
        hopper = Hopper(open_recording(path))
        hopper.start()
        eventually(lambda: len(unpacked) == 8)
        hopper.close()

    def test_it_closes_unemptied(self, recording_path: Path) -> None:
        hopper = Hopper(open_recording(recording_path), is_looping=True)
        hopper.start()
        hopper.close()
        assert hopper.take() is None


class Ground:
    """Where everything falls."""

    def __init__(self) -> None:
        self.edges_ns: list[int] = []
        self.arrived = threading.Semaphore(0)

    def drop(self, fall: Drop, edge_ns: int) -> None:
        self.edges_ns.append(edge_ns)
        self.arrived.release()


class TestBelt:
    @pytest.fixture
    def ground(self) -> Ground:
        return Ground()

    def test_it_runs_evenly_to_the_end(self, recording_path: Path, ground: Ground) -> None:
        belt = Belt(Hopper(open_recording(recording_path)), ground.drop, rate_hz=20)
        belt.open()
        belt.start()
        assert belt.ended.wait(PATIENCE_S)
        assert not belt.is_running
        # on time to the nanosecond, or late and never too soon after another
        assert all(later - earlier >= 50_000_000 for earlier, later in pairwise(ground.edges_ns))
        assert (belt.counters.stones, belt.counters.empty) == (2, 1)
        belt.close()

    def test_single_stones_while_it_stands(self, recording_path: Path, ground: Ground) -> None:
        belt = Belt(Hopper(open_recording(recording_path), is_looping=True), ground.drop, rate_hz=1000)
        belt.open()
        for _ in range(2):
            belt.drop_one()
            assert ground.arrived.acquire(timeout=PATIENCE_S)
        assert not belt.is_running
        belt.start()
        assert all(ground.arrived.acquire(timeout=PATIENCE_S) for _ in range(5))
        belt.stop()
        assert not belt.is_running
        belt.close()

    def test_it_starts_by_itself_when_all_is_ready(self, recording_path: Path, ground: Ground) -> None:
        is_ready = threading.Event()
        belt = Belt(Hopper(open_recording(recording_path)), ground.drop, rate_hz=100)
        belt.open()
        belt.start_when(is_ready.is_set)
        assert not belt.ended.wait(0.2)
        ready_ns = time.monotonic_ns()
        is_ready.set()
        assert belt.ended.wait(PATIENCE_S)
        assert ground.edges_ns[0] - ready_ns >= 1_000_000_000
        belt.close()

    def test_it_closes_at_any_moment(self, recording_path: Path, ground: Ground) -> None:
        for is_running in (False, True):
            belt = Belt(Hopper(open_recording(recording_path)), ground.drop, rate_hz=0.1)
            belt.open()
            if is_running:
                belt.start()
                eventually(lambda: len(ground.edges_ns) == 1)
            belt.close()

    def test_a_rate_is_positive(self, recording_path: Path, ground: Ground) -> None:
        belt = Belt(Hopper(open_recording(recording_path)), ground.drop, rate_hz=4)
        with pytest.raises(ValueError, match="rate_hz"):
            belt.rate_hz = 0
        assert belt.rate_hz == 4


class TestScene:
    """Two images of the empty rig, 1 and 2; stones are 3 and higher."""

    @pytest.fixture
    def scene(self) -> Scene:
        empty = [images(1), images(2)]
        return Scene(empty=empty, fall_ns=FALL_NS, exposure_us=EXPOSURE.exposure_us, gain_db=0.0)

    def test_a_stone_is_seen_while_it_passes(self, scene: Scene) -> None:
        scene.enter(1_000_000_000, images(3))
        see = scene.source_of(CAMERA)
        sight_ns = round(SIGHT_MS * 1e6)
        for off_ns in (0, sight_ns - 1, 1 - sight_ns):
            seen = see(replace(EXPOSURE, exposed_ns=1_000_000_000 + FALL_NS + off_ns))
            np.testing.assert_array_equal(seen, images(3)[CAMERA])
        for off_ns in (-FALL_NS, -sight_ns, sight_ns):
            seen = see(replace(EXPOSURE, n=2, exposed_ns=1_000_000_000 + FALL_NS + off_ns))
            np.testing.assert_array_equal(seen, images(1)[CAMERA])

    def test_the_nearest_of_two(self, scene: Scene) -> None:
        for n in range(10):
            scene.enter(n * 60_000_000, images(n))
        for n in (8, 9):
            seen = scene.source_of(CAMERA)(
                replace(EXPOSURE, exposed_ns=n * 60_000_000 + FALL_NS + 10_000_000)
            )
            np.testing.assert_array_equal(seen, images(n)[CAMERA])

    def test_a_camera_that_lags_on_a_busy_host_sees_what_was_there(self, scene: Scene) -> None:
        for n in range(3):
            scene.enter(n * 1_000_000_000, images(3 + n))
        seen = scene.source_of(CAMERA)(replace(EXPOSURE, exposed_ns=FALL_NS))
        np.testing.assert_array_equal(seen, images(3)[CAMERA])

    def test_a_light_that_an_output_fires_is_there_when_it_is_high(self) -> None:
        scene = Scene(
            empty=[images(1), images(2)], fall_ns=FALL_NS, exposure_us=20, gain_db=0, strobe_line="Line2"
        )
        see = scene.source_of(CAMERA)
        for lines, is_lit in ((("Line2",), True), (("Line3",), False), ((), False)):
            dark = [see(replace(EXPOSURE, n=n, high_lines=lines)) for n in (2, 4)]
            assert all((seen is not None and seen.max() > 1) == is_lit for seen in dark)
            assert is_lit or not np.array_equal(*dark)  # no sensor delivers the same image twice

    def test_a_camera_without_a_view_sends_nothing(self, scene: Scene) -> None:
        scene.enter(0, images(3))
        assert scene.source_of(CAMERAS[1])(replace(EXPOSURE, exposed_ns=FALL_NS)) is None

    def test_the_empty_rig_is_seen_in_turn(self, scene: Scene) -> None:
        for n in range(3):
            scene.enter_empty(n * 1_000_000_000)
            seen = scene.source_of(CAMERA)(replace(EXPOSURE, exposed_ns=n * 1_000_000_000 + FALL_NS))
            np.testing.assert_array_equal(seen, images(n % 2 + 1)[CAMERA])

    @pytest.mark.parametrize(
        ("exposure_us", "gain_db", "factor"),
        [(20.0, 0.0, 1.0), (20.01, 0.0, 1.0), (10.0, 0.0, 0.5), (40.0, 0.0, 2.0), (20.0, 20.0, 10.0)],
    )
    def test_brightness_follows_exposure_and_gain(
        self, scene: Scene, exposure_us: float, gain_db: float, factor: float
    ) -> None:
        scene.enter(0, images(3))
        exposure = replace(EXPOSURE, exposed_ns=FALL_NS, exposure_us=exposure_us, gain_db=gain_db)
        expected = np.minimum(np.rint(images(3)[CAMERA] * factor), 255)
        np.testing.assert_array_equal(scene.source_of(CAMERA)(exposure), expected)


def images(number: int) -> dict[CameraId, Image]:
    return {CAMERA: tagged_image(number, CAMERA)}
