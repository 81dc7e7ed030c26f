"""What follows from the checks of the parts, and what each part says of itself, by the checks that it makes."""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.interfaces import CameraProcessStatus, ProcessState
from pipeline.frames import CameraId
from pipeline.rig.design import nominal_rig
from pipeline.views.quality import ViewsParameters
from service.acquisition.rig_cameras import camera_checks, device_check
from service.base.camera_status import CameraStatus
from service.base.status import (
    AcquisitionState,
    AcquisitionStatus,
    CalibrationFacts,
    Checks,
    CheckStatus,
    Health,
    Ne107,
    trouble_check,
)
from service.calibration.calibrations import calibration_checks
from service.daemon.heartbeats import Heartbeats, Watched
from service.daemon.loop_watch import clock_check, loop_check
from service.health.alarms.rules import load_rules
from service.health.assessment import assess
from service.health.findings import CameraFinding, Severity, rig_ne107
from service.health.optical_watch import OpticalParameters, OpticalWatch
from service.health.refinement_watch import RefinementTrend, RefinementWatch
from service.health.rig_watch import CameraScore, RigWatch
from service.health.segmentation_watch import SegmentationWatch
from service.processing.segmenters import CLASSICAL, SegmenterPlan
from service.processing.spool import BundleFiles, Spool
from service.processing.worker_pool import workers_check
from service.store.checks import (
    LOW_DISK_BYTES,
    RetentionFacts,
    StoreUse,
    disk_check,
    retention_checks,
    store_check,
)
from service.store.trouble import StoreTrouble, TroubleCause

RIG = nominal_rig()
CALIBRATED = CalibrationFacts(calibration_id="rig", method="bundle", used_since="2026-11-21T04:00:00.000Z")


def cameras(lost: int = 0) -> list[CameraStatus]:
    return [
        CameraStatus(
            id=CameraId(f"c{number:02d}"),
            state="lost" if number <= lost else "armed",
            last_error="does not answer" if number <= lost else None,
        )
        for number in range(1, 17)
    ]


def rig(state: AcquisitionState, gate: str = "armed", gate_error: str | None = None) -> AcquisitionStatus:
    return AcquisitionStatus(state=state, gate=gate, gate_error=gate_error)


ARMED = rig(AcquisitionState.ARMED)


def devices(
    rig: AcquisitionStatus = ARMED, statuses: Sequence[CameraStatus] = tuple(cameras()), **state: Any
) -> Checks:
    healthy = {"common_cause": None, "process": CameraProcessStatus(), "blind_triggers": 0}
    of_cameras = camera_checks(statuses, **{**healthy, **state})
    return {**of_cameras, "gate": device_check(rig.gate, rig.gate_error, rig.gate_warnings)}


def queue(n: int, trouble: str | None = None) -> Checks:
    spool = Spool(BundleFiles(Path("spool")), max_bundles=16, camera_ids=())
    spool.n_queued = n
    if trouble is not None:
        spool._troubles["lost"] = trouble, time.monotonic()
    return spool.checks()


def dents(trend: RefinementTrend) -> Checks:
    watch = RefinementWatch()
    watch.trend = trend
    return watch.checks()


HEALTHY: Checks = {
    **dict.fromkeys(load_rules().checks[1:], trouble_check(None)),
    **devices(),
    "loop": loop_check(3.0),
    "clock": clock_check(None, is_unset=False),
    **queue(0),
    "workers": workers_check(2, 2, 0, None),
    **SegmentationWatch(CLASSICAL).checks(has_background=True),
    **calibration_checks(CALIBRATED),
    "store": store_check(None, (), last_seq=7, n_waiting=0),
    "disk": disk_check(100 * LOW_DISK_BYTES),
    **retention_checks(RetentionFacts(warn_days=7.0)),
    **RigWatch(RIG).checks(),
    **OpticalWatch(RIG, OpticalParameters()).checks(),
    **RefinementWatch().checks(),
}


def assessed(
    changed: Checks = {},  # noqa: B006 - never changed
    acquisition: AcquisitionStatus = ARMED,
    rig_ne107: Ne107 = Ne107.GOOD,
) -> Health:
    """Return the health of a healthy rig but for these checks, and for the state that no check has."""
    views = ViewsParameters()
    return assess([HEALTHY, changed], acquisition=acquisition, views=views, rig_ne107=rig_ne107)


def late(*parts: Watched) -> Checks:
    heartbeats = Heartbeats(dict.fromkeys(parts, 1.0))
    for part in parts:
        heartbeats.beat(part, 0.0)
    return {"progress": heartbeats.check(2.0)}


def test_a_healthy_rig_is_good_and_ready_and_its_checks_are_in_the_order_of_their_file():
    health = assessed()
    assert (health.ne107, health.ready, health.reasons) == (Ne107.GOOD, True, ())
    assert list(health.checks) == [
        *(f"camera:c{number:02d}" for number in range(1, 17)),
        *(
            "cameras",
            "gate",
            "camera_process",
            "trigger_line",
            "loop",
            "clock",
            "progress",
            "queue",
            "workers",
        ),
        *("quarantine", "background", "segmentation", "calibration", "drops", "store", "disk", "disk_days"),
        *(
            "retention",
            "backup",
            "keys",
            "recording",
            "archive",
            "webhooks",
            "file_drop",
            "issued_reports",
            "shift_sheets",
            "mail",
            "configuration",
        ),
        *("rig", "optics", "refinement", "conformity", "drift", "feed"),
    ]
    assert {check.status for check in health.checks.values()} == {CheckStatus.PASS}


def test_a_bad_product_says_nothing_of_the_device():
    health = assessed({"conformity": trouble_check("lot L1 does not conform")})
    assert (health.ne107, health.ready, health.reasons) == (Ne107.GOOD, True, ())


@pytest.mark.parametrize(
    ("lost", "state", "is_ready"),
    [
        (2, Ne107.MAINTENANCE_REQUIRED, True),
        (4, Ne107.MAINTENANCE_REQUIRED, True),
        (5, Ne107.OUT_OF_SPECIFICATION, True),
        (8, Ne107.OUT_OF_SPECIFICATION, True),
        (9, Ne107.FAILURE, False),
    ],
)
def test_lost_cameras_count_as_the_quality_they_still_allow(lost: int, state: Ne107, is_ready: bool):
    health = assessed(devices(statuses=cameras(lost)))
    assert (health.ne107, health.ready) == (state, is_ready)
    assert health.reasons[0] == "camera:c01: does not answer"
    assert len(health.reasons) == lost


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (devices(rig(AcquisitionState.ARMED, gate="lost", gate_error="unplugged")), "gate: unplugged"),
        (
            devices(blind_triggers=3),
            "trigger_line: 3 triggers in a row without any image: look at the line from gate to cameras",
        ),
        (
            devices(
                blind_triggers=3, process=CameraProcessStatus(state=ProcessState.SILENT, trouble="hangs")
            ),
            "camera_process: hangs",
        ),
        (queue(16), "queue: 16 of 16 waiting"),
        ({"workers": workers_check(0, 2, 0, None)}, "workers: 0 of 2 up, 0 restarts"),
        (
            late(Watched.ACQUISITION, Watched.PROCESSING),
            "progress: no progress of acquisition, processing: look at the journal",
        ),
        ({"disk": disk_check(10**7)}, "disk: 0.0 GB free for results"),
    ],
)
def test_without_a_part_there_are_no_results(changed: Checks, reason: str):
    health = assessed(changed)
    assert (health.ne107, health.ready, health.reasons) == (Ne107.FAILURE, False, (reason,))


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (
            devices(ARMED.model_copy(update={"gate_warnings": ("the beam has been closed",)})),
            "gate: the beam has been closed",
        ),
        (
            devices(process=CameraProcessStatus(state=ProcessState.REPLACED, replaced=1, trouble="hung")),
            "camera_process: hung",
        ),
        (
            {"loop": loop_check(300.0)},
            "loop: blocked for 300 ms within the last minute: look at the load of the machine",
        ),
        (queue(9), "queue: 9 of 16 waiting"),
        (queue(0, "3 stones lost"), "queue: 0 of 16 waiting; within the last minute: 3 stones lost"),
        (
            {"workers": workers_check(2, 2, 1, "deadline: not finished within 5 s")},
            "workers: 2 of 2 up, 1 restarts; within the last minute: deadline: not finished within 5 s",
        ),
        ({"workers": workers_check(1, 2, 4, None)}, "workers: 1 of 2 up, 4 restarts"),
        ({"keys": trouble_check("its keys are not accepted")}, "keys: its keys are not accepted"),
        ({"disk": disk_check(5 * 10**8)}, "disk: 0.5 GB free for results"),
    ],
)
def test_what_costs_no_result_yet_is_maintenance(changed: Checks, reason: str):
    health = assessed(changed)
    assert (health.ne107, health.ready, health.reasons) == (Ne107.MAINTENANCE_REQUIRED, True, (reason,))


@pytest.mark.parametrize(
    ("changed", "is_ready", "reason"),
    [
        (
            {"clock": clock_check(-3600.0, is_unset=False)},
            True,
            "clock: the wall clock was set by -3600.0 s: times of results are in doubt",
        ),
        (
            {"clock": clock_check(None, is_unset=True)},
            True,
            "clock: the wall clock was not set since the host started: give it a time server, or timedatectl set-time;"
            " until then results are marked time_is_doubtful",
        ),
        (
            SegmentationWatch(CLASSICAL).checks(has_background=False),
            False,
            "background: the empty rig was not exposed yet: let no stone fall for a moment",
        ),
        (
            SegmentationWatch(SegmenterPlan(model=b"an ONNX file")).checks(has_background=False),
            False,
            "background: the empty rig was not exposed yet: let no stone fall for a moment; until then the network"
            " alone finds them",
        ),
    ],
)
def test_what_makes_results_doubtful_is_out_of_specification(changed: Checks, is_ready: bool, reason: str):
    health = assessed(changed)
    assert (health.ne107, health.ready, health.reasons) == (Ne107.OUT_OF_SPECIFICATION, is_ready, (reason,))


def test_a_calibration_in_doubt_is_out_of_specification():
    failed = replace(CALIBRATED, trouble="verification 0001 failed")
    health = assessed(calibration_checks(failed), rig_ne107=rig_ne107((), failed))
    assert (health.ne107, health.ready) == (Ne107.OUT_OF_SPECIFICATION, True)
    assert health.reasons == ("calibration: verification 0001 failed",)


def test_while_balls_fall_results_are_not_those_of_stones():
    health = assessed(calibration_checks(replace(CALIBRATED, at_work="what falls is a ball")))
    assert (health.ne107, health.ready) == (Ne107.CHECK_FUNCTION, True)
    assert health.reasons == ("drops: what falls is a ball",)


@pytest.mark.parametrize(
    ("state", "ne107"),
    [(AcquisitionState.DISARMED, Ne107.CHECK_FUNCTION), (AcquisitionState.HELD, Ne107.FAILURE)],
)
def test_a_rig_that_is_not_armed_is_not_ready_and_says_so_first(state: AcquisitionState, ne107: Ne107):
    health = assessed({"loop": loop_check(300.0)}, acquisition=rig(state))
    assert (health.ne107, health.ready, health.reasons[0]) == (ne107, False, f"acquisition: {state}")


def test_the_most_urgent_reason_comes_first():
    loop, optics = {"loop": loop_check(414.0)}, {"optics": trouble_check("c07: dust of 14.5 %")}
    health = assessed({**loop, **optics, "store": store_check(None, ("corrupt-1",), last_seq=7, n_waiting=0)})
    assert [each.partition(": ")[0] for each in health.reasons] == ["store", "optics", "loop"]
    assert list(health.checks).index("loop") < list(health.checks).index("store")


def test_sixteen_lost_cameras_are_one_alarm_and_it_is_the_switch():
    health = assessed(devices(statuses=cameras(16), common_cause="all 16 are gone: look at the switch"))
    assert (health.ne107, health.ready) == (Ne107.FAILURE, False)
    assert health.reasons == ("cameras: all 16 are gone: look at the switch",)
    assert health.checks["camera:c07"].detail == "does not answer"


def test_what_a_camera_warns_of_is_maintenance():
    warned = [
        camera.model_copy(update={"warnings": ("receive buffer is small",)}) for camera in cameras()[:1]
    ]
    health = assessed(devices(statuses=[*warned, *cameras()[1:]]))
    assert (health.ne107, health.ready) == (Ne107.MAINTENANCE_REQUIRED, True)
    assert health.reasons == ("camera:c01: receive buffer is small",)


@pytest.mark.parametrize(
    ("severity", "state"),
    [
        (Severity.MAINTENANCE, Ne107.MAINTENANCE_REQUIRED),
        (Severity.OUT_OF_SPECIFICATION, Ne107.OUT_OF_SPECIFICATION),
    ],
)
def test_a_camera_that_moved_is_named_with_the_remedy(
    severity: Severity, state: Ne107, monkeypatch: pytest.MonkeyPatch
):
    moved = CameraFinding(
        cameras=(CameraId("c05"),), score_px=0.8, severity=severity, detail="moved: recalibrate"
    )
    watch = RigWatch(RIG)
    monkeypatch.setattr(watch, "findings", lambda: (moved,))
    health = assessed(watch.checks(), rig_ne107=rig_ne107((moved,), CALIBRATED))
    assert (health.ne107, health.ready) == (state, True)
    assert health.reasons == ("rig: c05: moved: recalibrate",)
    check = health.checks["rig"]
    assert (check.status, check.observed_value, check.observed_unit) == (CheckStatus.WARN, 0.8, "px")


def test_the_worst_score_of_a_healthy_rig_is_shown(monkeypatch: pytest.MonkeyPatch):
    scores = [CameraScore(), *(CameraScore(tangency_px=0.05 + 0.01 * n) for n in range(16))]
    watch = RigWatch(RIG)
    monkeypatch.setattr(watch, "scores", lambda: dict(enumerate(scores)))
    check = watch.checks()["rig"]
    assert (check.status, check.observed_value, check.detail) == (CheckStatus.PASS, 0.2, None)


@pytest.mark.parametrize(
    ("severity", "state"),
    [
        (Severity.MAINTENANCE, Ne107.MAINTENANCE_REQUIRED),
        (Severity.OUT_OF_SPECIFICATION, Ne107.OUT_OF_SPECIFICATION),
    ],
)
def test_dirty_windows_ask_for_maintenance_before_results_suffer(
    severity: Severity, state: Ne107, monkeypatch: pytest.MonkeyPatch
):
    c05, everywhere = CameraId("c05"), tuple(camera.id for camera in cameras())
    dusty = CameraFinding(cameras=(c05,), severity=severity, detail="clean window and lens")
    watch = OpticalWatch(RIG, OpticalParameters())
    monkeypatch.setattr(watch, "findings", lambda: (dusty,))
    health = assessed(watch.checks(), rig_ne107=rig_ne107((dusty,), CALIBRATED))
    assert (health.ne107, health.ready) == (state, True)
    assert health.reasons == ("optics: c05: clean window and lens",)
    assert health.checks["optics"].observed_value == 15
    weak = CameraFinding(cameras=everywhere, severity=severity, detail="look at the strobes' supply")
    monkeypatch.setattr(watch, "findings", lambda: (weak,))
    assert watch.checks()["optics"].detail == "all: look at the strobes' supply"


def test_dents_that_are_not_seen_ask_for_maintenance_and_stones_are_measured_on():
    seen = RefinementTrend(supported_share=0.6123, reference_share=0.8, rushed_share=0.1)
    health = assessed(dents(seen))
    check = health.checks["refinement"]
    assert (health.ne107, check.detail) == (Ne107.GOOD, None)
    assert (check.observed_value, check.observed_unit) == (0.612, "share")
    for trend, said in (
        (
            replace(seen, rushed_share=0.7, is_rushed=True),
            "70% of the latest stones were not refined because",
        ),
        (
            replace(seen, supported_share=0.3, has_fallen=True),
            "pixels support 30% of the surface, 80% at the",
        ),
    ):
        health = assessed(dents(trend))
        assert (health.ne107, health.ready) == (Ne107.MAINTENANCE_REQUIRED, True)
        (reason,) = health.reasons
        assert reason.startswith(f"refinement: {said}")


def test_a_held_store_is_a_failure_with_the_remedy():
    full = StoreTrouble(TroubleCause.FULL, "database or disk is full")
    held = store_check(full, (), last_seq=7, n_waiting=12)
    health = assessed({"store": held}, acquisition=rig(AcquisitionState.HELD))
    assert (health.ne107, health.ready) == (Ne107.FAILURE, False)
    assert health.reasons == (
        "acquisition: held",
        f"store: {full}; 12 stones wait for it",
    )


def test_what_was_moved_aside_stays_an_alarm_until_it_is_seen_to():
    lost = "aside/20261123T081100Z-lost-rows: The database ends at result 3"
    health = assessed({"store": store_check(None, (lost,), last_seq=3, n_waiting=0)})
    assert (health.ne107, health.ready) == (Ne107.MAINTENANCE_REQUIRED, True)
    (store,) = health.reasons
    assert store.startswith(f"store: store.dir/{lost}; look at it")


def test_a_disk_that_does_not_answer_fails():
    assert disk_check(None).status is CheckStatus.FAIL


def test_few_days_left_and_results_removed_unread_ask_for_maintenance():
    use = StoreUse(files_bytes=40 * 10**9, results_bytes=3 * 10**9, days_left=20.04)
    facts = RetentionFacts(use=use, warn_days=7.0, recordings_bytes=10**9)
    health = assessed(retention_checks(facts))
    assert (health.ne107, health.checks["disk_days"].observed_value) == (Ne107.GOOD, 20.0)
    assert "meshes and silhouettes take 40.0 GB, results 3.0 GB, recordings 1.0 GB" in str(
        health.checks["disk_days"].detail
    )
    unknown = assessed(retention_checks(replace(facts, use=replace(use, days_left=None))))
    assert (unknown.ne107, unknown.checks["disk_days"].observed_value) == (Ne107.GOOD, None)
    short = replace(facts, use=replace(use, days_left=6.9), overrun=("mes",), trouble="not permitted")
    health = assessed(retention_checks(short))
    assert (health.ne107, health.ready) == (Ne107.MAINTENANCE_REQUIRED, True)
    retention, days = health.reasons  # the more urgent first
    assert "make room, or set limits in [store.retention]" in days
    assert retention.startswith("retention: not permitted; results were removed that mes had not read")
