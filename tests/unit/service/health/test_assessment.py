from dataclasses import replace

import pytest

from drivers.interfaces import CameraProcessStatus, ProcessState
from pipeline.frames import CameraId
from pipeline.views.quality import ViewsParameters
from service.base.status import (
    AcquisitionState,
    AcquisitionStatus,
    CalibrationFacts,
    CameraStatus,
    CheckStatus,
    Ne107,
)
from service.health.assessment import assess
from service.health.facts import Facts
from service.health.optical_watch import OpticalFinding, Severity
from service.health.refinement_watch import RefinementTrend
from service.health.rig_watch import Suspicion
from service.health.store_checks import LOW_DISK_BYTES
from service.store.disk_use import RetentionFacts, StoreUse


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


HEALTHY = Facts(
    acquisition=rig(AcquisitionState.ARMED),
    blind_triggers=0,
    loop_ms=3.0,
    clock_step_s=None,
    cameras=cameras(),
    views=ViewsParameters(),
    waiting=0,
    max_waiting=16,
    workers=2,
    slots=2,
    worker_restarts=0,
    late=(),
    has_background=True,
    calibration=CalibrationFacts(
        calibration_id="rig", method="bundle", used_since="2026-11-21T04:00:00.000Z"
    ),
    refinement=RefinementTrend(),
    last_seq=7,
    free_bytes=100 * LOW_DISK_BYTES,
)


def test_a_healthy_rig_is_good_and_ready_and_names_every_part():
    health = assess(HEALTHY)
    assert (health.ne107, health.ready, health.reasons) == (Ne107.GOOD, True, ())
    checks = {
        "cameras",
        "camera_process",
        "trigger_line",
        "loop",
        "clock",
        "gate",
        "progress",
        "quarantine",
        "disk_days",
        "retention",
        "queue",
        "workers",
        "background",
        "segmentation",
        "calibration",
        "drops",
        "store",
        "disk",
        "backup",
        "keys",
        "recording",
        "archive",
        "webhooks",
        "file_drop",
        "configuration",
        "rig",
        "optics",
        "refinement",
    }
    assert health.checks.keys() == checks | {f"camera:c{number:02d}" for number in range(1, 17)}
    assert {check.status for check in health.checks.values()} == {CheckStatus.PASS}


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
    health = assess(replace(HEALTHY, cameras=cameras(lost)))
    assert (health.ne107, health.ready) == (state, is_ready)
    assert health.reasons[0] == "camera:c01: does not answer"
    assert len(health.reasons) == lost


@pytest.mark.parametrize(
    ("change", "state", "is_ready", "reason"),
    [
        (
            {"acquisition": rig(AcquisitionState.DISARMED)},
            Ne107.CHECK_FUNCTION,
            False,
            "acquisition: disarmed",
        ),
        (
            {"acquisition": rig(AcquisitionState.HELD, gate="lost", gate_error="unplugged")},
            Ne107.FAILURE,
            False,
            "gate: unplugged",
        ),
        (
            {
                "acquisition": rig(AcquisitionState.ARMED).model_copy(
                    update={"gate_warnings": ("the beam has been closed",)}
                )
            },
            Ne107.MAINTENANCE_REQUIRED,
            True,
            "gate: the beam has been closed",
        ),
        (
            {"blind_triggers": 3},
            Ne107.FAILURE,
            False,
            "trigger_line: 3 triggers in a row without any image: look at the line from gate to cameras",
        ),
        (
            {
                "blind_triggers": 3,
                "camera_process": CameraProcessStatus(state=ProcessState.SILENT, trouble="hangs"),
            },
            Ne107.FAILURE,
            False,
            "camera_process: hangs",
        ),
        (
            {"camera_process": CameraProcessStatus(state=ProcessState.REPLACED, replaced=1, trouble="hung")},
            Ne107.MAINTENANCE_REQUIRED,
            True,
            "camera_process: hung",
        ),
        (
            {"loop_ms": 300.0},
            Ne107.MAINTENANCE_REQUIRED,
            True,
            "loop: blocked for 300 ms within the last minute: look at the load of the machine",
        ),
        (
            {"clock_step_s": -3600.0},
            Ne107.OUT_OF_SPECIFICATION,
            True,
            "clock: the wall clock was set by -3600.0 s: times of results are in doubt",
        ),
        (
            {"clock_is_unset": True},
            Ne107.OUT_OF_SPECIFICATION,
            True,
            "clock: the wall clock was not set since the host started: give it a time server, or timedatectl set-time;"
            " until then results are marked time_is_doubtful",
        ),
        ({"waiting": 9}, Ne107.MAINTENANCE_REQUIRED, True, "queue: 9 of 16 waiting"),
        ({"waiting": 16}, Ne107.FAILURE, False, "queue: 16 of 16 waiting"),
        (
            {"spool_trouble": "3 stones lost since the start (16 bundles were waiting)"},
            Ne107.MAINTENANCE_REQUIRED,
            True,
            "queue: 0 of 16 waiting; within the last minute: "
            "3 stones lost since the start (16 bundles were waiting)",
        ),
        (
            {"worker_restarts": 1, "worker_trouble": "deadline: not finished within 5 s"},
            Ne107.MAINTENANCE_REQUIRED,
            True,
            "workers: 2 of 2 up, 1 restarts; within the last minute: deadline: not finished within 5 s",
        ),
        (
            {"key_trouble": "state/keys.json: Invalid JSON: its keys are not accepted"},
            Ne107.MAINTENANCE_REQUIRED,
            True,
            "keys: state/keys.json: Invalid JSON: its keys are not accepted",
        ),
        (
            {"quarantined": ["1-00000007.tiff"]},
            Ne107.MAINTENANCE_REQUIRED,
            True,
            "quarantine: no worker survived 1-00000007.tiff",
        ),
        (
            {"workers": 1, "worker_restarts": 4},
            Ne107.MAINTENANCE_REQUIRED,
            True,
            "workers: 1 of 2 up, 4 restarts",
        ),
        ({"workers": 0}, Ne107.FAILURE, False, "workers: 0 of 2 up, 0 restarts"),
        (
            {"late": ["processing"]},
            Ne107.FAILURE,
            False,
            "progress: no progress of processing: look at the journal",
        ),
        (
            {"has_background": False},
            Ne107.OUT_OF_SPECIFICATION,
            False,
            "background: the empty rig was not exposed yet: let no stone fall for a moment",
        ),
        (
            {"has_background": False, "has_network": True},
            Ne107.OUT_OF_SPECIFICATION,
            False,
            "background: the empty rig was not exposed yet: let no stone fall for a moment; until then the network"
            " alone finds them",
        ),
        (
            {"segmentation_warning": "classical mode: roi.onnx: is damaged"},
            Ne107.MAINTENANCE_REQUIRED,
            True,
            "segmentation: classical mode: roi.onnx: is damaged",
        ),
        ({"free_bytes": 5 * 10**8}, Ne107.MAINTENANCE_REQUIRED, True, "disk: 0.5 GB free for results"),
        ({"free_bytes": 10**7}, Ne107.FAILURE, False, "disk: 0.0 GB free for results"),
    ],
)
def test_whatever_is_wrong_is_named(change, state: Ne107, is_ready: bool, reason: str):
    health = assess(replace(HEALTHY, **change))
    assert (health.ne107, health.ready) == (state, is_ready)
    assert reason in health.reasons


def test_what_is_not_delivered_asks_for_maintenance_and_no_more():
    troubles = ("mes: disabled since 2026-03-02T00:00:00.000Z: HTTP 500",)
    health = assess(
        replace(HEALTHY, webhook_troubles=troubles, file_drop_trouble="/mnt/mes: there is no such folder")
    )
    assert (health.ne107, health.ready) == (Ne107.MAINTENANCE_REQUIRED, True)
    assert health.checks["webhooks"].detail == troubles[0]
    assert health.checks["file_drop"].detail == "/mnt/mes: there is no such folder"


def test_sixteen_lost_cameras_are_one_alarm_and_it_is_the_switch():
    health = assess(replace(HEALTHY, cameras=cameras(16), common_cause="all 16 are gone: look at the switch"))
    assert (health.ne107, health.ready) == (Ne107.FAILURE, False)
    assert health.reasons == ("cameras: all 16 are gone: look at the switch",)
    assert health.checks["camera:c07"].detail == "does not answer"


def test_what_a_camera_warns_of_is_maintenance():
    warned = [
        camera.model_copy(update={"warnings": ("receive buffer is small",)}) for camera in cameras()[:1]
    ]
    health = assess(replace(HEALTHY, cameras=[*warned, *cameras()[1:]]))
    assert (health.ne107, health.ready) == (Ne107.MAINTENANCE_REQUIRED, True)
    assert health.reasons == ("camera:c01: receive buffer is small",)


@pytest.mark.parametrize(
    ("is_dropped", "state"), [(False, Ne107.MAINTENANCE_REQUIRED), (True, Ne107.OUT_OF_SPECIFICATION)]
)
def test_a_camera_that_moved_is_named_with_the_remedy(is_dropped: bool, state: Ne107):
    moved = Suspicion(
        camera=CameraId("c05"), score_px=0.8, is_dropped=is_dropped, detail="moved: recalibrate"
    )
    health = assess(replace(HEALTHY, suspicions=(moved,)))
    assert (health.ne107, health.ready) == (state, True)
    assert health.reasons == ("rig: c05: moved: recalibrate",)
    check = health.checks["rig"]
    assert (check.status, check.observed_value, check.observed_unit) == (CheckStatus.WARN, 0.8, "px")


def test_the_worst_score_of_a_healthy_rig_is_shown():
    scored = [
        camera.model_copy(update={"tangency_px": 0.05 + 0.01 * n}) for n, camera in enumerate(cameras())
    ]
    check = assess(replace(HEALTHY, cameras=scored)).checks["rig"]
    assert (check.status, check.observed_value, check.detail) == (CheckStatus.PASS, 0.2, None)


@pytest.mark.parametrize(
    ("severity", "state"),
    [
        (Severity.MAINTENANCE, Ne107.MAINTENANCE_REQUIRED),
        (Severity.OUT_OF_SPECIFICATION, Ne107.OUT_OF_SPECIFICATION),
    ],
)
def test_dirty_windows_ask_for_maintenance_before_results_suffer(severity: Severity, state: Ne107):
    c05, everywhere = CameraId("c05"), tuple(camera.id for camera in HEALTHY.cameras)
    dusty = OpticalFinding(cameras=(c05,), severity=severity, detail="clean window and lens")
    health = assess(replace(HEALTHY, optical_findings=(dusty,)))
    assert (health.ne107, health.ready) == (state, True)
    assert health.reasons == ("optics: c05: clean window and lens",)
    assert health.checks["optics"].observed_value == 15
    weak = OpticalFinding(cameras=everywhere, severity=severity, detail="look at the strobes' supply")
    assert assess(replace(HEALTHY, optical_findings=(weak,))).reasons == (
        "optics: all: look at the strobes' supply",
    )


def test_dents_that_are_not_seen_ask_for_maintenance_and_stones_are_measured_on():
    seen = RefinementTrend(supported_share=0.6123, reference_share=0.8, rushed_share=0.1)
    health = assess(replace(HEALTHY, refinement=seen))
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
        health = assess(replace(HEALTHY, refinement=trend))
        assert (health.ne107, health.ready) == (Ne107.MAINTENANCE_REQUIRED, True)
        (reason,) = health.reasons
        assert reason.startswith(f"refinement: {said}")


def test_a_held_store_is_a_failure_with_the_remedy():
    full = "database or disk is full: make room on the disk of store.dir"
    health = assess(
        replace(HEALTHY, acquisition=rig(AcquisitionState.HELD), store_trouble=full, without_outcome=12)
    )
    assert (health.ne107, health.ready) == (Ne107.FAILURE, False)
    assert health.reasons == ("acquisition: held", f"store: {full}; 12 stones wait for it")


def test_what_was_moved_aside_and_a_failed_backup_stay_alarms_until_they_are_seen_to():
    lost = "aside/20261123T081100Z-lost-rows: The database ends at result 3"
    health = assess(replace(HEALTHY, store_incidents=(lost,), backup_trouble="no room"))
    assert (health.ne107, health.ready) == (Ne107.MAINTENANCE_REQUIRED, True)
    store, backup = health.reasons
    assert store.startswith(f"store: store.dir/{lost}; look at it")
    assert backup == "backup: no room"


def test_a_disk_that_does_not_answer_fails():
    assert assess(replace(HEALTHY, free_bytes=None)).checks["disk"].status is CheckStatus.FAIL


def test_few_days_left_and_results_removed_unread_ask_for_maintenance():
    use = StoreUse(files_bytes=40 * 10**9, results_bytes=3 * 10**9, days_left=20.04)
    facts = RetentionFacts(use=use, warn_days=7.0, recordings_bytes=10**9)
    health = assess(replace(HEALTHY, retention=facts))
    assert (health.ne107, health.checks["disk_days"].observed_value) == (Ne107.GOOD, 20.0)
    assert "meshes and silhouettes take 40.0 GB, results 3.0 GB, recordings 1.0 GB" in str(
        health.checks["disk_days"].detail
    )
    unknown = assess(replace(HEALTHY, retention=replace(facts, use=replace(use, days_left=None))))
    assert (unknown.ne107, unknown.checks["disk_days"].observed_value) == (Ne107.GOOD, None)
    short = replace(facts, use=replace(use, days_left=6.9), overrun=("mes",), trouble="not permitted")
    health = assess(replace(HEALTHY, retention=short))
    assert (health.ne107, health.ready) == (Ne107.MAINTENANCE_REQUIRED, True)
    days, retention = health.reasons
    assert "make room, or set limits in [store.retention]" in days
    assert retention.startswith("retention: not permitted; results were removed that mes had not read")
