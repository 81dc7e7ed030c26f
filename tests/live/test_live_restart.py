"""The daemon comes and goes while the rig runs: killed, stopped, and started before all cameras are there."""

from pathlib import Path

import pytest
from support.daemon_process import DaemonProcess
from support.left_in_spool import whole_bundles
from support.live_rig import SPACING_S, LiveRig, eventually, live_rig, live_section, simulated_rig
from support.small_recording import write_small_recording

from drivers.cameras.aravis import AravisCamera
from drivers.cameras.genicam import GigeCameraSettings
from drivers.files.recording import open_recording
from service.store.accounting import Accounting, accounting
from service.store.schema import connect_reader


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("spheres") / "recording"
    write_small_recording(path, n_stones=4, n_backgrounds=3)
    return path


def accounting_in(folder: Path, session: int) -> Accounting:
    """What a daemon has left in its store."""
    with connect_reader(folder / "state/results.sqlite") as connection:
        return accounting(connection, session)


@pytest.mark.full
@pytest.mark.parametrize(("delay", "rate_hz"), [("camera", 4.0), ("gate", 10.0)])
def test_after_a_kill_the_next_daemon_is_armed_and_misses_nothing(
    tmp_path: Path, recording: Path, delay: str, rate_hz: float
) -> None:
    """Also with several stones in the air."""
    with simulated_rig(tmp_path, recording, rate_hz=rate_hz, number=4) as rig:
        more = f'delay = "{delay}"'
        section = live_section(rig, tmp_path, recording, more=more, by_address=True, at_start=0)
        with DaemonProcess(tmp_path, recording, rig=section) as daemon:
            daemon.hear("READY=1")
            live = LiveRig(rig, daemon)
            live.wait_until_whole()
            rig.belt.start()
            daemon.wait_for("/accounting", lambda now: now["measured"] >= 2 and now["in_progress"] >= 1)
            daemon.process.kill()
            daemon.process.wait()
        before = accounting_in(tmp_path, 1)
        spooled = whole_bundles(tmp_path, open_recording(recording).camera_ids)
        with DaemonProcess(tmp_path, recording, rig=section) as daemon:
            daemon.hear("READY=1")
            live = LiveRig(rig, daemon)
            live.wait_until_whole()
            daemon.wait_for("/accounting?session=1", lambda now: now["in_progress"] == 0)
            after = accounting_in(tmp_path, 1)
            assert (after.triggers, after.measured) == (before.triggers, before.measured + len(spooled))
            assert after.is_balanced
            n_crash = after.by_reason.get("crash", 0)
            assert n_crash == after.lost - before.lost == before.in_progress - len(spooled)
            rig.belt.stop()
            daemon.wait_for(
                "/accounting?session=current",
                lambda now: now["by_reason"].get("down", 0) >= 1 and now["in_progress"] == 0,
            )
            live.measure_until_whole()  # the recording shows the empty rig itself, which this daemon has not seen yet
            daemon.wait_for("/acquisition", lambda now: (now["last_stone_age_s"] or 0) > 2 * SPACING_S)
            daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0)
            counts = daemon.get("/accounting?session=current")
            assert counts["is_balanced"], counts
            assert counts["by_reason"]["down"] >= 1
            fallen = sum(each["n_stones"] for each in live.results(0))  # many are one entry
            assert before.triggers + counts["triggers"] == fallen


@pytest.mark.full
def test_millions_that_the_gate_counted_alone_are_one_entry_and_delay_nothing(
    tmp_path: Path, recording: Path
) -> None:
    many, hours = 10_000_000, 700
    with simulated_rig(tmp_path, recording, number=6) as rig:
        section = live_section(rig, tmp_path, recording, by_address=True, at_start=2)
        with DaemonProcess(tmp_path, recording, rig=section) as daemon:
            daemon.hear("READY=1")
            live = LiveRig(rig, daemon)
            live.wait_until_whole()
            daemon.wait_for("/accounting", lambda now: now["backgrounds"] == 2)
            live.measure_until_whole()
            daemon.process.kill()
            daemon.process.wait()
        rig.gate.count_unheard(many, hours * 3600)  # while no daemon runs
        with DaemonProcess(tmp_path, recording, rig=section) as daemon:
            daemon.hear("READY=1")
            live = LiveRig(rig, daemon)
            live.wait_until_whole()
            daemon.wait_for("/accounting", lambda now: now["by_reason"].get("down", 0) >= many)
            live.measure_until_whole()
            rig.gate.unplug()
            eventually(lambda: live.acquisition()["gate"] == "lost", "the gate is lost")
            rig.gate.count_unheard(many, hours * 3600)  # while its plug is pulled
            rig.gate.plug()
            counts = daemon.wait_for("/accounting", lambda now: now["by_reason"].get("no_frames", 0) >= many)
            assert counts["is_balanced"]
            live.measure_until_whole()
            assert [each["n_stones"] for each in live.results(0) if each["n_stones"] > 1] == [many, many]
            assert daemon.stop() == 0
        every = accounting_in(tmp_path, 1).triggers + accounting_in(tmp_path, 2).triggers
        assert every == 2 * many + rig.gate.counters.edges


@pytest.mark.full
def test_sigterm_measures_what_fell_and_lets_the_cameras_go(tmp_path: Path, recording: Path) -> None:
    with live_rig(tmp_path, recording, by_address=True, number=5) as live:
        n_dropped = live.stones
        live.rig.belt.start()
        live.daemon.wait_for("/accounting", lambda now: now["measured"] >= 2)
        n_fallen = live.stones
        assert live.daemon.stop() == 0
        assert all(camera.controller is None for camera in live.rig.cameras.values())
        counts = accounting_in(tmp_path, 1)
        assert n_fallen <= counts.triggers + n_dropped <= live.stones
        assert counts.is_balanced
        assert counts.measured == counts.triggers
        camera = live.camera("c01").design
        settings = GigeCameraSettings(
            id=camera.id,
            address=camera.address,
            interfaces=("127.0.0.1",),
            image_size_px=camera.image_size_px,
            may_be_simulated=True,
        )
        successor = AravisCamera(settings)
        successor.open()
        assert successor.examine().serial == camera.serial
        successor.close()


@pytest.mark.full
def test_a_camera_that_is_missing_at_the_start_is_admitted_when_it_appears(
    tmp_path: Path, recording: Path
) -> None:
    with simulated_rig(tmp_path, recording, number=6) as rig:
        missing = rig.cameras[next(reversed(rig.cameras))]
        missing.stop()
        section = live_section(rig, tmp_path, recording, by_address=True)
        with DaemonProcess(tmp_path, recording, rig=section) as daemon:
            daemon.hear("READY=1")
            live = LiveRig(rig, daemon)
            assert live.acquisition()["state"] == "armed"
            assert live.acquisition()["cameras_armed"] == 15
            status = live.status(missing.id)
            assert status["state"] == "lost"
            assert f"does not answer at {missing.design.address}" in status["last_error"]
            daemon.wait_for("/accounting", lambda counts: counts["backgrounds"] == 2)
            (stone,) = live.measure(1)
            assert (stone["outcome"], len(stone["views"])) == ("measured", 15)
            assert stone["dropped_views"] == {missing.id: "camera_lost"}
            missing.start()
            live.wait_until_whole(15)
            assert live.status(missing.id)["recoveries"] == 1
            *_, whole = live.measure(5)  # in between the empty rig is exposed: the camera had not seen it yet
            assert (whole["outcome"], len(whole["views"])) == ("measured", 16)
