"""All cameras of the rig: each is kept armed, watched in every bundle, and reported to operators."""

import asyncio
import logging
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np

from drivers.errors import LossCause
from drivers.interfaces import (
    Camera,
    CameraBack,
    CameraLost,
    CameraProcessStatus,
    DeviceEvent,
    EventSink,
    FrameLost,
    ProcessState,
)
from pipeline.frames import CameraId, Frame, FrameBundle, Image, MissingReason
from service.acquisition.device_keeper import DeviceKeeper, DeviceLoss
from service.acquisition.exposure_skew import ExposureSkew
from service.base.camera_status import CameraStatus
from service.base.messages import Code, CodedText, about, joined, message
from service.base.status import Checks, DeviceState, HealthCheck, health_check
from service.bundling.frame_account import BundlingCounters, CameraCounters

log = logging.getLogger(__name__)

NOT_CAUSED_BY_CAMERA: frozenset[str] = frozenset(MissingReason) - {
    MissingReason.NO_FRAME, MissingReason.AMBIGUOUS, MissingReason.OTHER_EXPOSURE, MissingReason.FROZEN
}  # fmt: skip
"""Reasons of missing frames that say nothing against an armed camera."""
REOPENED_FOR: Mapping[str, str] = {
    MissingReason.NO_FRAME: message(Code.CAMERA_SENDS_NOTHING),
    MissingReason.FROZEN: message(Code.CAMERA_FROZEN),
}
"""Reasons of repeatedly missing frames for which the camera is opened anew, with what the operator is told."""
MAX_MISSES = 3
"""Triggers in a row without an image after which a camera is opened anew although it answers.

Not where its images come too late, as on a machine that is overloaded: opening cameras would only add to the load.
"""
MAX_RECENT_MISSES, RECENT_TRIGGERS = 4, 16
"""Health names a camera from which this many images of its latest triggers are missing, in a row or not."""
BLIND_TRIGGERS = 3
"""Triggers in a row without any image from which the line between gate and cameras is taken to be broken."""
MAX_SKEW_US = 20.0
"""A pixel of fall: with more the views of a stone contradict each other."""
FPS_OVER_S = 10.0
RECENT = 64


@dataclass(slots=True)
class _RigCamera:
    """One camera of the rig, with what is known of its latest frames."""

    keeper: DeviceKeeper
    frames: int = 0
    image: Image | None = None
    received_s: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    latencies_ms: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    misses: int = 0  # triggers in a row
    missed: deque[bool] = field(default_factory=lambda: deque(maxlen=RECENT_TRIGGERS))
    frames_then: int = 0  # before them, or before the latest `MAX_MISSES` of them
    last_miss_reason: str = ""
    counters: CameraCounters = field(default_factory=CameraCounters)  # since the rig was last armed
    earlier: Counter[str] = field(default_factory=Counter)  # the same, summed over the armed periods before


class RigCameras:
    """Keeps all cameras armed from `arm` to `close`, and watches them by their events and bundles.

    An armed period: `use_counters` and `arm`; `refuse_repeated` and `track` for every event, `check_bundle` for
    every bundle; `close`. `is_live`: two images that are equal bit for bit come from a camera that is stuck, not
    from a recording.
    """

    def __init__(
        self,
        cameras: Mapping[CameraId, Camera],
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        is_live: bool = False,
    ) -> None:
        self._clock = clock  # that `received_ns` of the devices' events is read from
        self._is_live = is_live
        self._sink: EventSink | None = None
        self._cameras = {
            name: _RigCamera(
                DeviceKeeper(
                    name,
                    device,
                    examine=device.examine,
                    on_lost=partial(self._report_lost, name),
                    on_back=partial(self._report_back, name),
                )
            )
            for name, device in cameras.items()
        }
        self._skew = ExposureSkew()
        self.blind_triggers = 0
        """Triggers in a row for which no camera that answers had an image."""

    @property
    def ids(self) -> tuple[CameraId, ...]:
        return tuple(self._cameras)

    @property
    def armed(self) -> int:
        """Number of cameras that are armed."""
        return sum(camera.keeper.state is DeviceState.ARMED for camera in self._cameras.values())

    @property
    def lost(self) -> dict[CameraId, DeviceKeeper]:
        return {name: c.keeper for name, c in self._cameras.items() if c.keeper.state is DeviceState.LOST}

    def use_counters(self, counters: BundlingCounters) -> None:
        """Report the counters of a new armed period, added to those of the periods before."""
        for name, camera in self._cameras.items():
            camera.earlier.update(asdict(camera.counters))
            camera.counters = counters.cameras[name]

    async def arm(self, sink: EventSink, tasks: asyncio.TaskGroup) -> None:
        """Keep all cameras armed from now on; return when each has been tried once."""
        self._sink = sink
        for camera in self._cameras.values():
            camera.keeper.start(sink, tasks)
        await asyncio.gather(*(camera.keeper.tried.wait() for camera in self._cameras.values()))

    async def close(self) -> None:
        """Disarm and close all cameras."""
        await asyncio.gather(*(camera.keeper.close() for camera in self._cameras.values()))

    def abandon(self) -> None:
        """Stop waiting for any camera."""
        for camera in self._cameras.values():
            camera.keeper.abandon()

    @property
    def common_cause(self) -> CodedText | None:
        """Why all cameras are lost, None as long as one is not."""
        losses = [keeper.loss for keeper in self.lost.values() if keeper.loss is not None]
        return common_cause(losses) if len(losses) == len(self._cameras) > 1 else None

    def trouble(self, min_cameras: int) -> CodedText | None:
        """Return the reason for too few cameras, None when there are enough."""
        if self.armed >= min_cameras:
            return None
        if (cause := self.common_cause) is not None:
            return cause
        reason = next((keeper.last_error for keeper in self.lost.values()), None)
        needed = message(Code.CAMERAS_NEEDED, armed=self.armed, needed=min_cameras)
        return joined([about(", ".join(self.lost), reason or "not armed"), needed])

    def refuse_repeated(self, event: DeviceEvent) -> DeviceEvent:
        """Return the event, or a `FrameLost` in the place of an image that repeats the camera's previous one."""
        if isinstance(event, Frame) and self._is_live:
            previous = self._cameras[event.camera].image
            if previous is not None and np.array_equal(previous, event.image):
                frozen = MissingReason.FROZEN
                return FrameLost(camera=event.camera, received_ns=event.received_ns, reason=frozen)
        return event

    def track(self, event: DeviceEvent) -> None:
        """Keep the newest frame of each camera, and mark cameras as lost."""
        match event:
            case Frame():
                camera = self._cameras[event.camera]
                camera.frames += 1
                camera.image = event.image
                camera.received_s.append(time.monotonic())
            case CameraLost():
                self._cameras[event.camera].keeper.mark_lost(event.reason, event.cause)
                self._cameras[event.camera].missed.clear()
                self.blind_triggers = 0  # it was not there to have an image
            case CameraBack():
                self._cameras[event.camera].image = None  # an image from before the loss proves nothing

    def check_bundle(self, bundle: FrameBundle) -> None:
        """Update skew and latency of the cameras in a bundle; examine those whose frame is missing."""
        self._skew.feed({name: frame.device_ns for name, frame in bundle.frames.items()})
        silent = []
        for name, camera in self._cameras.items():
            is_armed = camera.keeper.state is DeviceState.ARMED
            if (frame := bundle.frames.get(name)) is not None:
                camera.misses, camera.frames_then = 0, camera.frames
                camera.missed.append(False)
                camera.latencies_ms.append((frame.received_ns - bundle.trigger.received_ns) / 1e6)
            elif is_armed and bundle.missing[name] not in NOT_CAUSED_BY_CAMERA:
                camera.last_miss_reason = bundle.missing[name]
                silent.append((name, camera))
        # an image that came in part, or twice, was exposed: the line from gate to cameras works
        are_exposed = bool(bundle.frames) or any(
            camera.last_miss_reason != MissingReason.NO_FRAME for _, camera in silent
        )
        if are_exposed:
            self.blind_triggers = 0
        elif silent:  # without any image the cause is common to all cameras
            self.blind_triggers += 1
        for name, camera in silent:
            camera.keeper.examine_now()
            if not are_exposed:
                continue
            camera.misses += 1
            camera.missed.append(True)
            if camera.misses == MAX_MISSES:
                log.warning("%s camera=%s", _miss_warning(camera), name)
            if camera.misses % MAX_MISSES == 0:
                comes_late = camera.frames > camera.frames_then
                camera.frames_then = camera.frames
                if camera.last_miss_reason in REOPENED_FOR and not comes_late:
                    self._report_lost(name, REOPENED_FOR[camera.last_miss_reason])

    def statuses(self) -> list[CameraStatus]:
        """Return state, and counters since the start, of all cameras, in the order of the rig."""
        masters = [name for name, camera in self._cameras.items() if _is_clock_master(camera)]
        return [
            _status(name, camera, self._skew.skew_us(name), masters if name in masters else [])
            for name, camera in self._cameras.items()
        ]

    def latest_image(self, name: CameraId) -> Image | None:
        """Return a camera's latest frame, None while there is none."""
        return self._cameras[name].image

    def _report_lost(self, name: CameraId, reason: str, cause: LossCause = LossCause.OTHER) -> None:
        self._deliver(CameraLost(camera=name, received_ns=self._clock(), reason=reason, cause=cause))

    def _report_back(self, name: CameraId) -> None:
        self._deliver(CameraBack(camera=name, received_ns=self._clock()))

    def _deliver(self, event: CameraLost | CameraBack) -> None:
        if self._sink is not None:
            self._sink.deliver(event)


def common_cause(losses: Sequence[DeviceLoss]) -> CodedText:
    """Name the cause that all lost cameras share, the network if none answers, and the first camera's reason."""
    first = losses[0].message
    if all(loss.cause is LossCause.PROCESS_ENDED for loss in losses):
        return first
    are_silent = all(loss.cause is LossCause.SILENT for loss in losses)
    lost = message(Code.CAMERAS_SILENT if are_silent else Code.CAMERAS_LOST, cameras=len(losses))
    told = CodedText(f"the first one: {first}", about("first", first).findings)
    return CodedText(f"{lost}{'; ' if are_silent else ', '}{told}", (*lost.findings, *told.findings))


def _is_clock_master(camera: _RigCamera) -> bool:
    return camera.keeper.state is DeviceState.ARMED and camera.keeper.vitals.ptp_status == "Master"


def _status(
    name: CameraId, camera: _RigCamera, skew_us: float | None, masters: Sequence[CameraId]
) -> CameraStatus:
    """Return the status of a camera: what it says of itself and what was counted have the same names there.

    `masters` are all masters of clocks if it is one of them: one among slaves is right, several are not.
    """
    keeper, latencies_ms, now_s = camera.keeper, camera.latencies_ms, time.monotonic()
    counted = camera.earlier + Counter(asdict(camera.counters))
    told: dict[str, Any] = {**asdict(keeper.vitals), **counted, "frames": camera.frames}
    warnings = list(told.pop("warnings"))
    if skew_us is not None and skew_us > MAX_SKEW_US:
        warnings.append(message(Code.CAMERA_SKEWED, skew_us=skew_us))
    if len(masters) > 1:
        warnings.append(message(Code.CLOCK_MASTERS, masters=", ".join(masters)))
    if camera.misses >= MAX_MISSES:
        warnings.append(_miss_warning(camera))
    elif (n_missed := sum(camera.missed)) >= MAX_RECENT_MISSES:
        warnings.append(message(Code.CAMERA_LOSES, images=n_missed, triggers=len(camera.missed)))
    n_recent = sum(now_s - at_s <= FPS_OVER_S for at_s in camera.received_s)
    return CameraStatus(
        id=name,
        state=keeper.state,
        last_error=keeper.last_error,
        recoveries=keeper.recoveries,
        **told,
        fps=round(n_recent / FPS_OVER_S, 2),
        latency_ms=None if not latencies_ms else round(sum(latencies_ms) / len(latencies_ms), 3),
        latency_min_ms=None if not latencies_ms else round(min(latencies_ms), 3),
        latency_max_ms=None if not latencies_ms else round(max(latencies_ms), 3),
        last_frame_age_s=None if not camera.received_s else round(now_s - camera.received_s[-1], 3),
        skew_us=None if skew_us is None else round(skew_us, 1),
        warnings=tuple(warnings),
    )


def _miss_warning(camera: _RigCamera) -> CodedText:
    return message(Code.CAMERA_MISSES, images=camera.misses, reported=str(camera.last_miss_reason))


def camera_checks(
    cameras: Sequence[CameraStatus],
    *,
    common_cause: str | None,
    process: CameraProcessStatus,
    blind_triggers: int,
) -> Checks:
    """Return the checks of each camera, of all, and of their lines; `common_cause` says why all cameras are lost."""
    # while the process of the cameras is silent, that is the reason for triggers without images
    is_broken = blind_triggers >= BLIND_TRIGGERS and process.state is not ProcessState.SILENT
    blind = message(Code.TRIGGER_LINE_BLIND, triggers=blind_triggers)
    told = process.trouble and message(Code(f"camera_process_{process.state}"), reported=process.trouble)
    n_there = sum(camera.state is not DeviceState.LOST for camera in cameras)
    of_cameras = {
        f"camera:{camera.id}": device_check(camera.state, camera.last_error, camera.warnings)
        for camera in cameras
    }
    return of_cameras | {
        "cameras": health_check(common_cause, n_there, "cameras", fail=common_cause is not None),
        "camera_process": health_check(
            told,
            process.replaced,
            "replaced",
            warn=process.state is ProcessState.REPLACED,
            fail=process.state is ProcessState.SILENT,
        ),
        "trigger_line": health_check(
            blind if is_broken else None, blind_triggers, "triggers", fail=is_broken
        ),
    }


def device_check(state: DeviceState, error: str | None, warnings: Sequence[str]) -> HealthCheck:
    """Check that a device is there, and that it warns of nothing."""
    is_lost = state is DeviceState.LOST
    detail = error if is_lost else joined(warnings)
    return health_check(detail, state, warn=bool(warnings), fail=is_lost)
