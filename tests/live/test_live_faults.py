"""The fault table on real packets: the daemon, the real Aravis driver, a serial gate and a simulated rig.

One daemon for all rows, in the order of the table: whatever a row breaks must be whole again for the next, and a row
that fails costs the next one the start of another rig. Without `--full` one row of each kind: packets, a camera, all
cameras, its counter, and the gate's lines.
"""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from support.extents import first_quick
from support.live_rig import LiveRig, eventually, live_rig
from support.renewed import HAS_FAILED, Renewed
from support.small_recording import write_small_recording


@pytest.fixture(scope="module")
def rigs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Renewed[LiveRig]]:
    recording = tmp_path_factory.mktemp("recording") / "recording"
    write_small_recording(recording, n_stones=7, n_backgrounds=4)
    with Renewed(lambda: live_rig(tmp_path_factory.mktemp("live"), recording)) as rigs:
        yield rigs


@pytest.fixture
def live(rigs: Renewed[LiveRig], request: pytest.FixtureRequest) -> Iterator[LiveRig]:
    """A rig, whole before and after; nothing that fell is missing from the books."""
    with rigs.lent_to(request.node) as rig:
        rig.wait_until_whole()
        yield rig
        if request.node.stash.get(HAS_FAILED, False):
            return
        for camera in rig.rig.cameras.values():
            camera.faults.clear()
        rig.rig.gate.faults.clear()
        rig.wait_until_whole()
        counts = rig.accounting()
        assert counts["is_balanced"], counts
        assert counts["in_progress"] == 0, counts
        rig.measure_until_whole()


def views(results: list[dict]) -> list[int]:
    return [len(result["views"]) for result in results]


def all_measured(results: list[dict]) -> bool:
    return all(result["outcome"] == "measured" for result in results)


def stones(results: list[dict]) -> list[dict]:
    """Without the exposures of the empty rig that nobody announced: to the daemon they are stones as well."""
    return [result for result in results if result["reason"] != "empty"]


# --- C: cameras and their network ---


@pytest.mark.parametrize("loss", first_quick([0.05, 0.01]))
@pytest.mark.full
def test_c1_lost_packets_are_resent_and_stones_keep_all_their_views(live: LiveRig, loss: float):
    before = {camera: live.status(camera)["resent_packets"] for camera in ("c01", "c16")}
    for camera in live.rig.cameras.values():
        camera.faults.packet_loss = loss
    results = live.measure(6)
    while (
        views(results).count(16) < 6
    ):  # a busy machine may send a packet again too late; without resends: none
        assert len(results) < 24, [result["dropped_views"] for result in results]
        results += live.measure(2)
    assert all_measured(results)
    eventually(
        lambda: sum(live.status(camera)["resent_packets"] - before[camera] for camera in before) > 0,
        "resent packets are told",
    )


def test_c1_what_a_camera_cannot_resend_is_a_missing_view(live: LiveRig):
    live.camera("c05").faults.set("no_resend", True)
    live.camera("c05").faults.set("lost_packets", [3])
    results = live.measure(2)
    assert all_measured(results)
    assert [result["dropped_views"] for result in results] == [{"c05": "timeout"}] * 2
    assert live.status("c05")["state"] == "armed"


def test_c2_a_cable_that_is_pulled_costs_a_view_until_it_is_plugged_in_again(live: LiveRig):
    live.camera("c02").unplug()
    assert views(live.measure(1)) == [15]
    eventually(lambda: live.status("c02")["state"] == "lost", "c02 is lost")
    assert "does not answer" in live.status("c02")["last_error"]
    assert views(live.measure(2)) == [15, 15]
    recoveries = live.status("c02")["recoveries"]
    live.camera("c02").replug()
    eventually(lambda: live.status("c02")["recoveries"] == recoveries + 1, "c02 is back")


@pytest.mark.full
def test_c2_a_power_cycle_forgets_settings_and_they_are_written_again(live: LiveRig):
    live.camera("c03").power_cycle(1.0)
    assert views(live.measure(1)) == [15]
    eventually(lambda: live.camera("c03").feature("ExposureTime") == 20.0, "c03 is set again")


@pytest.mark.full
def test_c2_a_camera_with_a_new_address_is_found_by_its_serial_number(live: LiveRig):
    old = live.camera("c04").design.address
    network, _, _ = old.rpartition(".")
    live.camera("c04").power_cycle(0.5, address=f"{network}.200")
    assert views(live.measure(1)) == [15]
    eventually(lambda: live.status("c04")["address"] == f"{network}.200", "c04 is found")


@pytest.mark.full
def test_c2_another_camera_in_a_place_is_not_used(live: LiveRig):
    serial = live.camera("c06").design.serial
    live.camera("c06").power_cycle(0.2, serial="STRANGER")
    assert views(live.measure(2)) == [15, 15]
    eventually(lambda: live.status("c06")["state"] == "lost", "c06 is lost")
    live.camera("c06").power_cycle(0.2, serial=serial)
    live.wait_until_whole()


@pytest.mark.full
@pytest.mark.restarts_cameras
def test_c2_a_camera_that_was_killed_is_back_within_ten_seconds(live: LiveRig):
    live.camera("c07").stop()
    assert views(live.measure(3)) == [15, 15, 15]
    live.camera("c07").start()
    live.wait_until_whole(10)


@pytest.mark.full
def test_c2_control_taken_by_another_application_is_taken_back(live: LiveRig):
    live.camera("c08").steal_control(3.0)
    assert all_measured(live.measure(2))
    eventually(lambda: live.status("c08")["state"] == "lost", "c08 is lost")
    live.wait_until_whole(15)


@pytest.mark.full
def test_c3_without_any_camera_it_is_the_switch_and_stones_are_counted(live: LiveRig):
    for camera in live.rig.cameras.values():
        camera.unplug()
    lost = live.measure(2)
    assert [result["outcome"] for result in lost] == ["lost", "lost"]
    eventually(lambda: live.acquisition()["state"] == "held", "held")
    eventually(lambda: live.acquisition()["cameras_armed"] == 0, "all are lost")
    advice = (
        "all 16 cameras are gone: look at the switch"  # once each has been tried again and does not answer
    )
    live.daemon.check("cameras", lambda now: str(now["detail"]).startswith(advice))
    health = live.daemon.get("/health")
    assert len([reason for reason in health["reasons"] if "camera" in reason]) == 1
    assert health["ne107"] == "failure"
    (lost,) = live.measure(1)
    assert (lost["outcome"], lost["reason"]) == ("lost", "no_frames")
    for camera in live.rig.cameras.values():
        camera.replug()
    live.wait_until_whole(30)


@pytest.mark.full
def test_c3_the_process_of_the_cameras_dies_and_only_stones_meanwhile_have_no_images(live: LiveRig):
    pid, before = live.daemon.camera_pid(), live.status("c01")["recoveries"]
    assert "libaravis" not in Path(f"/proc/{live.daemon.process.pid}/maps").read_text()
    seq = live.last_seq()
    os.kill(pid, signal.SIGSTOP)
    live.fall(1)
    os.kill(pid, signal.SIGKILL)
    lost = live.wait_for_results(seq, 1)
    assert [(result["outcome"], result["reason"]) for result in lost] == [("lost", "no_frames")]
    live.wait_until_whole(30)
    assert live.status("c01")["recoveries"] == before + 1
    assert "process of the cameras ended (SIGKILL)" in live.status("c01")["last_error"]
    assert live.daemon.camera_pid() != pid
    assert views(live.measure(2)) == [16, 16]


@pytest.mark.full
def test_c3_a_process_of_the_cameras_that_hangs_is_named_and_replaced(live: LiveRig):
    pid, before = live.daemon.camera_pid(), live.status("c01")["recoveries"]
    event = live.daemon.get("/events?after=0&limit=1")["last_seq"]
    seq = live.last_seq()
    os.kill(pid, signal.SIGSTOP)
    while live.status("c01")["recoveries"] == before:
        live.fall(1)
    live.wait_until_whole(30)
    assert live.daemon.camera_pid() != pid
    assert "hung, without a heartbeat for 2 s, and was killed" in live.status("c01")["last_error"]
    replaced = live.daemon.check("camera_process", lambda now: now["status"] == "warn")
    assert replaced["observed_value"] >= 1
    live.daemon.wait_for("/accounting", lambda now: now["in_progress"] == 0)
    assert views(live.measure(2)) == [16, 16]
    assert live.accounting()["is_balanced"]
    lost = [result for result in live.results(seq) if result["outcome"] == "lost"]
    assert {result["reason"] for result in lost} == {"no_frames"}
    # the end of another process, shortly before, may have raised this alarm already
    live.daemon.wait_for("/alarms", lambda now: "camera_process" in [each["check"] for each in now["items"]])
    events = live.daemon.get(f"/events?after={event}&limit=1000")["items"]
    assert "trigger_line" not in {each["subject"] for each in events if each["type"] == "alarm.raised"}


@pytest.mark.full
def test_c4_a_frame_that_comes_a_period_late_is_in_no_other_bundle(live: LiveRig):
    before = live.status("c09")
    live.camera("c09").faults.late_ms = 270.0
    results = live.measure(3)
    assert all_measured(results)
    assert views(results) == [16, 16, 16]  # its clock says to which stone each frame belongs
    assert live.status("c09")["missing"] == before["missing"]
    assert live.status("c09")["latency_max_ms"] > 500, "that they come late is to be seen"
    live.camera("c09").faults.late_ms = 1200.0
    counted = ("late", "strays", "unannounced")
    # a camera that a busy machine loses meanwhile is opened anew, and its late frames are gone
    for n_missed in (2, 4, 6, 8):
        results = live.measure(2)
        assert all_measured(results)
        assert all("c09" not in result["views"] for result in results)
        assert live.status("c09")["missing"] >= before["missing"] + n_missed
        with suppress(AssertionError):
            eventually(
                lambda: any(live.status("c09")[each] > before[each] for each in counted),
                "the late frames are counted",
                timeout_s=20,
            )
            return
    pytest.fail("late frames are never counted")


@pytest.mark.full
def test_c5_a_camera_that_misses_a_trigger_is_right_again_with_the_next(live: LiveRig):
    live.measure(1)
    for _ in range(4):  # the belt exposes the empty rig at times, and the fault may hit that
        live.camera("c10").faults.missed_triggers = 1
        results = live.measure(3)
        assert all_measured(results)
        if views(results) != [16, 16, 16]:
            break
    assert views(results) == [15, 16, 16]
    eventually(lambda: live.status("c10")["not_exposed"] >= 1, "its counter shows it")


@pytest.mark.full
def test_c6_a_frozen_image_is_no_view(live: LiveRig):
    live.camera("c11").faults.frozen = True
    results = live.measure(3)
    assert all_measured(results)
    assert views(results)[1:] == [15, 15]
    live.camera("c11").faults.frozen = False


@pytest.mark.full
def test_c7_settings_changed_by_someone_else_are_found_and_written_again(live: LiveRig):
    live.camera("c01").tamper("ExposureTime", 500.0)
    eventually(lambda: live.camera("c01").feature("ExposureTime") == 20.0, "set again")
    live.daemon.hear_line("ExposureTime")


@pytest.mark.full
@pytest.mark.parametrize("by_s", [1000, 3, -2])
def test_c8_a_clock_that_was_set_costs_one_view_at_most(live: LiveRig, by_s: int):
    live.measure(1)
    live.camera("c12").jump_clock(by_s * 10**9)
    results = live.measure(3)
    assert all_measured(results)
    assert min(views(results)) >= 15
    assert views(results)[2] == 16


# --- D: the light gate ---


def test_d1_a_bounce_is_merged_and_a_double_is_one_stone(live: LiveRig):
    before, stones = live.acquisition(), live.accounting()["triggers"]
    live.rig.gate.faults.bounce = 1.0
    assert views(live.measure(2)) == [16, 16]
    eventually(
        lambda: live.acquisition()["triggers_ignored"] >= before["triggers_ignored"] + 2, "bounces are told"
    )
    live.rig.gate.faults.bounce, live.rig.gate.faults.doubled = 0.0, 1.0
    assert views(live.measure(2)) == [16, 16]
    assert live.accounting()["triggers"] == stones + 4
    assert live.acquisition()["triggers_ignored"] >= before["triggers_ignored"] + 4


@pytest.mark.full
def test_d2_a_stone_that_the_gate_does_not_announce_is_measured_all_the_same(live: LiveRig):
    before = live.acquisition()
    live.rig.gate.faults.uncounted = 1.0
    results = live.measure(3)
    assert all_measured(results)
    assert views(results) == [16, 16, 16]
    assert all(result["bundle"].endswith("-orphan") for result in results)
    assert live.acquisition()["orphans"] == before["orphans"] + 3
    gate = live.daemon.check("gate", lambda now: now["status"] == "warn")
    assert "not announced" in gate["detail"] or "the gate says nothing" in gate["detail"]


@pytest.mark.full
def test_d2_a_lost_line_is_an_orphan_and_a_gap(live: LiveRig):
    before = live.acquisition()
    live.rig.gate.faults.corrupted = 1.0
    live.fall(1)
    live.rig.gate.faults.corrupted = 0.0
    results = live.measure(2)
    assert all_measured(stones(results))
    assert live.acquisition()["orphans"] >= before["orphans"] + 1
    eventually(lambda: live.acquisition()["triggers_lost"] >= before["triggers_lost"] + 1, "the gap is told")
    live.daemon.check("gate", lambda now: "its counter went on by" in (now["detail"] or ""))
    assert live.acquisition()["unseen"] == before["unseen"]


@pytest.mark.full
@pytest.mark.parametrize("spacing_s", [0.05, 0.02])
def test_d6_a_burst_is_counted_stone_by_stone(live: LiveRig, spacing_s: float):
    """One that closes the beam while, or right after, another does is ignored as its bounce, and counted as that."""
    before, ignored, stones = live.last_seq(), live.acquisition()["triggers_ignored"], live.stones
    live.fall(20, spacing_s=spacing_s)
    n_fallen = live.stones - stones

    def n_accounted() -> int:
        return len(live.results(before)) + live.acquisition()["triggers_ignored"] - ignored

    eventually(
        lambda: n_accounted() >= n_fallen and live.accounting()["in_progress"] == 0,
        "all are accounted for",
        60,
    )
    results = live.results(before)
    assert n_accounted() == n_fallen >= 20
    measured = [result for result in results if result["outcome"] == "measured"]
    assert len(measured) >= 2
    # a camera that is not ready for the next stone, or whose packets came too late, leaves views out
    assert {result["reason"] for result in results} <= {None, "no_frames", "insufficient_views", "empty"}
    assert live.acquisition()["in_dead_time"] > 0


@pytest.mark.full
def test_d7_slow_workers_fill_the_queue_and_nothing_is_silently_dropped(live: LiveRig):
    before = live.last_seq()
    live.daemon.signal_workers(signal.SIGSTOP)
    live.fall(6)
    live.daemon.check("queue", lambda now: now["observed_value"] >= 6)
    live.daemon.signal_workers(signal.SIGCONT)
    assert all_measured(live.wait_for_results(before, 6))


@pytest.mark.full
def test_d7_a_machine_that_stands_still_for_longer_than_frames_are_waited_for_loses_no_stone(live: LiveRig):
    before = live.last_seq()
    live.fall(1, spacing_s=0.1)  # announced, not yet exposed
    live.daemon.process.send_signal(signal.SIGSTOP)
    threading.Event().wait(1.0)
    live.daemon.process.send_signal(signal.SIGCONT)
    results = live.wait_for_results(before, 1)
    assert all_measured(results)
    assert views(results) == [16]


@pytest.mark.full
def test_d8_garbage_and_half_lines_are_survived(live: LiveRig):
    live.rig.gate.faults.garbage = 0.7
    assert all_measured(live.measure(3))
    live.rig.gate.faults.clear()
    before = live.last_seq()
    live.rig.gate.faults.halved = 1.0
    live.fall(1)
    live.rig.gate.faults.clear()
    live.fall(1)
    assert all_measured(stones(live.wait_for_results(before, 2)))


@pytest.mark.full
def test_d8_while_the_serial_line_is_unplugged_stones_are_measured_as_orphans(live: LiveRig):
    before, seq = live.acquisition(), live.last_seq()
    live.rig.gate.unplug()
    eventually(lambda: live.acquisition()["state"] == "held", "held")
    live.daemon.check("gate", lambda now: now["status"] == "fail")
    live.fall(2)
    live.rig.gate.plug()
    live.wait_until_whole(15)
    eventually(lambda: len(stones(live.results(seq))) >= 2, "both have an outcome")
    assert all_measured(stones(live.results(seq)))
    assert live.acquisition()["orphans"] >= before["orphans"] + 2
    eventually(lambda: live.acquisition()["triggers_lost"] >= before["triggers_lost"] + 2, "the gap is told")
    live.measure(1)
    assert live.acquisition()["unseen"] == before["unseen"]


@pytest.mark.full
def test_d10_without_stones_nobody_is_alarmed(live: LiveRig):
    before = len(live.daemon.log)
    threading.Event().wait(6.0)  # more than one examination of each camera
    assert live.daemon.get("/health")["ready"]
    assert " ERROR " not in live.daemon.log[before:]
