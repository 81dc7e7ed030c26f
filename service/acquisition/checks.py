"""Health of the rig's devices: each camera, all of them, the light gate, and the lines between."""

from collections.abc import Sequence

from drivers.interfaces import CameraProcessStatus, ProcessState
from service.base.status import (
    AcquisitionStatus,
    CameraStatus,
    Checks,
    DeviceState,
    HealthCheck,
    health_check,
)

BLIND_TRIGGERS = 3
"""Triggers in a row without any image from which the line between gate and cameras is taken to be broken."""


def rig_checks(
    rig: AcquisitionStatus,
    cameras: Sequence[CameraStatus],
    *,
    common_cause: str | None,
    process: CameraProcessStatus,
    blind_triggers: int,
) -> Checks:
    """Return the checks of all devices; `common_cause` says why all cameras are lost."""
    # while the process of the cameras is silent, that is the reason for triggers without images
    is_broken = blind_triggers >= BLIND_TRIGGERS and process.state is not ProcessState.SILENT
    blind = f"{blind_triggers} triggers in a row without any image: look at the line from gate to cameras"
    n_there = sum(camera.state is not DeviceState.LOST for camera in cameras)
    of_cameras = {
        f"camera:{camera.id}": _device(camera.state, camera.last_error, camera.warnings) for camera in cameras
    }
    return of_cameras | {
        "cameras": health_check(common_cause, n_there, "cameras", fail=common_cause is not None),
        "camera_process": health_check(
            process.trouble,
            process.replaced,
            "replaced",
            warn=process.state is ProcessState.REPLACED,
            fail=process.state is ProcessState.SILENT,
        ),
        "gate": _device(rig.gate, rig.gate_error, rig.gate_warnings),
        "trigger_line": health_check(
            blind if is_broken else None, blind_triggers, "triggers", fail=is_broken
        ),
    }


def _device(state: DeviceState, error: str | None, warnings: Sequence[str]) -> HealthCheck:
    is_lost = state is DeviceState.LOST
    detail = error if is_lost else "; ".join(warnings) or None
    return health_check(detail, state, warn=bool(warnings), fail=is_lost)
