"""Account of what became of every trigger and every frame: it makes losses visible, also those that ids reveal."""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from drivers.interfaces import FrameLost
from pipeline.frames import CameraId, Frame, FrameBundle
from service.bundling.exposure_check import id_step
from service.bundling.window import OpenTrigger

REMEMBERED_TRIGGERS = 64
"""Closed triggers that late frames are compared with."""


@dataclass(slots=True, kw_only=True)
class CameraCounters:
    """Counts of what became of one camera's frames."""

    used: int = 0
    missing: int = 0  # bundles without a frame of this camera
    lost: int = 0  # losses that the driver reported
    late: int = 0
    duplicates: int = 0
    extra: int = 0  # several different frames for one trigger
    other_exposure: int = 0
    strays: int = 0  # frames without a trigger
    not_exposed: int = 0  # triggers that its frame ids did not count
    unannounced: int = 0  # exposures without a trigger, by its frame ids
    id_restarts: int = 0


@dataclass(slots=True, kw_only=True)
class BundlingCounters:
    """Totals since the assembler was made; `triggers = complete + incomplete` once nothing is open."""

    triggers: int = 0
    complete: int = 0
    incomplete: int = 0
    in_dead_time: int = 0  # of the incomplete
    orphans: int = 0  # known from their frames alone
    unseen: int = 0  # of the incomplete: counted by the gate, but neither announced nor photographed
    triggers_ignored: int = 0  # merged by the gate itself, or announced when they were orphans already
    triggers_lost: int = 0  # gaps in the gate's counter: orphans and unseen ones
    cameras: dict[CameraId, CameraCounters] = field(default_factory=dict)


class _Closed(NamedTuple):
    expected_ns: int
    frame_ids: Mapping[CameraId, int]


class FrameAccount:
    """Updates `counters`, and remembers the last closed triggers in order to recognise their late frames."""

    def __init__(self, counters: Mapping[CameraId, CameraCounters], window_ns: int) -> None:
        self._counters = counters
        self._window_ns = window_ns
        self._closed: deque[_Closed] = deque(maxlen=REMEMBERED_TRIGGERS)
        self._last_used: dict[CameraId, tuple[int, int]] = {}  # frame id, ordinal

    @property
    def closed_ns(self) -> list[int]:
        """Times at which the frames of the remembered triggers were expected."""
        return [closed.expected_ns for closed in self._closed]

    def count_closed(self, window: OpenTrigger, bundle: FrameBundle) -> None:
        """Count the used and the missing frames of a bundle that leaves."""
        for camera, frame in bundle.frames.items():
            self._verify_id(camera, frame.frame_id, window.ordinal)
            self._counters[camera].used += 1
        if not window.is_spoiled:
            for camera in bundle.missing:
                self._counters[camera].missing += 1
        if not window.in_dead_time:
            self._closed.append(_frame_ids(window))

    def count_after_close(self, camera: CameraId, received_ns: int, frame: Frame | None) -> bool:
        """Count a frame that came for a closed trigger; return whether it did. `frame` is None for a loss."""
        for expected_ns, frame_ids in self._closed:
            if abs(received_ns - expected_ns) > self._window_ns:
                continue
            if frame is not None:
                counters, used_id = self._counters[camera], frame_ids.get(camera)
                if used_id is None:
                    counters.late += 1
                elif used_id == frame.frame_id:
                    counters.duplicates += 1
                else:
                    counters.extra += 1
            return True
        return False

    def count_unmatched(
        self, events: Iterable[Frame | FrameLost], open_windows: Iterable[OpenTrigger]
    ) -> None:
        """Count frames that no trigger came for: late when the last trigger before lacks it, else strays."""
        triggers = [*self._closed, *map(_frame_ids, open_windows)]
        for frame in events:
            if isinstance(frame, FrameLost):
                continue
            earlier = [closed for closed in triggers if closed.expected_ns < frame.received_ns]
            if earlier and frame.camera not in earlier[-1].frame_ids:
                self._counters[frame.camera].late += 1
            else:
                self._counters[frame.camera].strays += 1

    def _verify_id(self, camera: CameraId, frame_id: int, ordinal: int) -> None:
        """Compare the step of the camera's counter with the number of triggers since its last used frame."""
        last = self._last_used.get(camera)
        self._last_used[camera] = (frame_id, ordinal)
        if last is None:
            return
        counters = self._counters[camera]
        n_exposed = id_step(last[0], frame_id)
        if n_exposed is None:
            counters.id_restarts += 1
            return
        n_triggers = ordinal - last[1]
        counters.not_exposed += max(0, n_triggers - n_exposed)
        counters.unannounced += max(0, n_exposed - n_triggers)


def _frame_ids(window: OpenTrigger) -> _Closed:
    return _Closed(window.expected_ns, {camera: frame.frame_id for camera, frame in window.frames.items()})
