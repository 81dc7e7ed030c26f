"""Account of every camera's frames: used, missing, late or stray, and the losses that their counters reveal."""

from collections import deque
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from pipeline.frames import CameraId, Frame, FrameBundle
from service.bundling.counters import CameraCounters
from service.bundling.exposure_check import id_step
from service.bundling.window import OpenTrigger

REMEMBERED_TRIGGERS = 16
"""Closed triggers that late frames are compared with."""


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
            self._closed.append(_Closed(window.expected_ns, _frame_ids(window)))

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

    def count_unmatched(self, frames: Iterable[Frame], open_windows: Iterable[OpenTrigger]) -> None:
        """Count frames outside of every window: late when the last trigger before lacks it, else strays."""
        triggers = [
            *self._closed,
            *(_Closed(window.expected_ns, _frame_ids(window)) for window in open_windows),
        ]
        for frame in frames:
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


def _frame_ids(window: OpenTrigger) -> dict[CameraId, int]:
    return {camera: frame.frame_id for camera, frame in window.frames.items()}
