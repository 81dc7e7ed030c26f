"""The player of a recording: delivers its triggers to a gate and its frames to the cameras, at their times.

One thread delivers every event at its time on the belt's own clock: a trigger to the gate, 259 ms later the
frames to the cameras, the next trigger maybe in between. Intervals within a bundle are as recorded; so are those
from trigger to trigger, unless the bundles were put into another order.

The clock runs with the host's monotonic clock (times `speed`) and never passes an event that is not yet
delivered: a belt that falls behind slows time instead of losing frames.
"""

import heapq
import threading
import time
from dataclasses import replace
from itertools import count
from pathlib import Path
from statistics import median_low
from typing import Literal, NamedTuple

from drivers.errors import RecordingError
from drivers.files.recording import BundleHeader, Recording, playback_order, read_bundle, unreadable_triggers
from drivers.interfaces import DeviceEvent, EventSink, FrameLossReason, FrameLost, PlaybackEnded
from drivers.outlet import Outlet
from pipeline.frames import CameraId, FrameBundle, Trigger

Pace = Literal["recorded", "stepped", "fast"]
"""`recorded`: in real time, times `speed`. `stepped` and `fast`: without waiting, one bundle for each permit."""

SPACING_NS = 250_000_000
"""From a trigger to the next where the recording does not say."""
MAX_SPACING_NS = 60_000_000_000
"""Longer pauses are shortened to this: between two recordings that were put together lie days."""
FRAME_DELAY_NS = 259_400_000
"""From a trigger to its frames where the recording does not say."""


class _Due(NamedTuple):
    """An event to be delivered; sorts by time, and by order of scheduling where times are equal."""

    at_ns: int
    order: int
    outlet: Outlet
    event: DeviceEvent


class ReplayBelt:
    """Plays while the gate is plugged in; keeps its place while it is unplugged.

    A damaged page is delivered as `FrameLost`, as are all frames of a bundle that cannot be read. At the end, and
    again whenever the gate is plugged in after that, the gate gets `PlaybackEnded`.

    Attributes
    ----------
    recording
        What is played.
    gate, cameras
        The outlets that replay devices plug their sinks into.
    pace
        When it delivers what.
    """

    def __init__(
        self, recording: Recording, *, pace: Pace = "recorded", speed: float = 1.0, loop: bool = False
    ) -> None:
        if speed <= 0:
            raise ValueError(f"speed must be positive, not {speed:g}")
        self.recording = recording
        self.gate = Outlet()
        self.cameras = {camera: Outlet() for camera in recording.camera_ids}
        self.pace = pace
        self._speed = speed if pace == "recorded" else 1.0
        self._headers = playback_order(recording)
        self._unreadable = unreadable_triggers(recording)
        self._loop = loop
        self._position = 0  # in all rounds
        self._verified: set[Path] = set()
        self._delay_ns = _frame_delay_ns(self._headers)
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._is_stopping = False
        self._has_told_end = False
        self._permits = 0
        self._next: FrameBundle | None = None
        self._last: tuple[int, int] | None = None  # last trigger's time: recorded, played
        self._due: list[_Due] = []
        self._order = count()
        now_ns = time.monotonic_ns()
        self._clock: tuple[int, int, int | None] = (now_ns, now_ns, None)  # played, real, held at

    def clock(self) -> int:
        """Return the time on the belt in ns: the clock of every event's `received_ns`."""
        played_ns, real_ns, held_ns = self._clock
        now_ns = played_ns + round((time.monotonic_ns() - real_ns) * self._speed)
        return now_ns if held_ns is None else min(now_ns, held_ns)

    def permit(self, n_bundles: int = 1) -> None:
        """Let `n_bundles` more pass, in the paces `stepped` and `fast`."""
        with self._changed:
            self._permits += n_bundles
            self._changed.notify_all()

    def step(self) -> None:
        """Let the next bundle pass."""
        self.permit(1)

    def start(self, sink: EventSink) -> None:
        """Plug the gate in and play."""
        self.gate.plug(sink)
        with self._changed:
            self._has_told_end = False
            if self._thread is None:
                self._is_stopping = False
                self._thread = threading.Thread(target=self._run, name="replay belt", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def pause(self) -> None:
        """Unplug the gate: the frames of its last trigger are still delivered, no further trigger is."""
        self.gate.unplug()
        with self._changed:
            self._changed.notify_all()

    def stop(self) -> None:
        """Pause and end the thread; frames that are still due are dropped."""
        self.pause()
        with self._changed:
            thread, self._thread = self._thread, None
            self._is_stopping = True
            self._changed.notify_all()
        if thread is not None:
            thread.join()
            self._due.clear()
            self._hold(None)

    # --- the thread ---

    def _run(self) -> None:
        while True:
            if self._next is None:
                self._next = self._load_next()
            with self._changed:
                if self._is_stopping:
                    return
                due = self._wait_for_due()
            if due is not None:
                due.outlet.deliver(due.event)

    def _wait_for_due(self) -> _Due | None:
        """Return the event to deliver now; None when something changed meanwhile, so that the caller asks again."""
        start_ns = self._next_start_ns()
        times_ns = [
            at_ns for at_ns in (start_ns, self._due[0].at_ns if self._due else None) if at_ns is not None
        ]
        if not times_ns:
            return self._idle()
        at_ns = min(times_ns)
        self._hold(at_ns)
        if self.pace != "recorded":
            self._clock = (at_ns, time.monotonic_ns(), at_ns)
        elif (wait_ns := at_ns - self.clock()) > 0:
            self._changed.wait(wait_ns / self._speed / 1e9)
            return None
        if start_ns == at_ns and self._next is not None:
            self._schedule(self._next, start_ns)
            self._next = None
            self._permits -= 1
            return None
        return heapq.heappop(self._due)

    def _next_start_ns(self) -> int | None:
        """Return when the next trigger is due; None without a bundle, a plugged gate or a permit."""
        is_permitted = self.pace == "recorded" or self._permits > 0
        if self._next is None or not self.gate.is_plugged or not is_permitted:
            return None
        if self._last is None:
            return self.clock()
        recorded_ns, played_ns = self._last
        spacing_ns = self._next.trigger.received_ns - recorded_ns
        if spacing_ns <= 0:
            spacing_ns = SPACING_NS
        return max(played_ns + min(spacing_ns, MAX_SPACING_NS), self.clock())

    def _idle(self) -> _Due | None:
        """Wait for a change when nothing is due; returns `PlaybackEnded` once at the end."""
        self._hold(None)
        if self._next is None and self.gate.is_plugged and not self._has_told_end:
            self._has_told_end = True
            now_ns = self.clock()
            return _Due(now_ns, 0, self.gate, PlaybackEnded(received_ns=now_ns))
        self._changed.wait()
        return None

    def _hold(self, at_ns: int | None) -> None:
        """Let the clock run up to `at_ns` and no further; None: without end."""
        played_ns, real_ns, _ = self._clock
        self._clock = (played_ns, real_ns, at_ns)

    def _schedule(self, bundle: FrameBundle, start_ns: int) -> None:
        """Schedule all events of a bundle, shifted in time by the same amount."""
        trigger = bundle.trigger
        self._last = (trigger.received_ns, start_ns)
        shift_ns = start_ns - trigger.received_ns

        def put(outlet: Outlet, event: DeviceEvent) -> None:
            heapq.heappush(self._due, _Due(event.received_ns, next(self._order), outlet, event))

        put(
            self.gate, replace(trigger, received_ns=start_ns, device_ns=_shifted(trigger.device_ns, shift_ns))
        )
        for frame in bundle.frames.values():
            put(
                self.cameras[frame.camera],
                replace(
                    frame,
                    received_ns=frame.received_ns + shift_ns,
                    device_ns=_shifted(frame.device_ns, shift_ns),
                ),
            )
        for camera, reason in bundle.missing.items():
            lost = FrameLost(
                camera=camera,
                received_ns=start_ns + self._delay_ns,
                reason=reason,
                problem=bundle.unreadable,
            )
            put(self.cameras[camera], lost)

    def _load_next(self) -> FrameBundle | None:
        """Read the next bundle, numbered on from the last round; None at the end.

        Unreadable bundles come at the end of the first round, and in no other.
        """
        n_first = len(self._headers) + len(self._unreadable)
        if self._position < n_first:
            played_round, index = 0, self._position
        else:
            played_round, index = divmod(self._position - n_first, len(self._headers))
            played_round += 1
        if played_round > 0 and not self._loop:
            return None
        self._position += 1
        if index >= len(self._headers):
            trigger, error = self._unreadable[index - len(self._headers)]
            return self._without_frames(trigger, error)
        return self._renumbered(self._read(self._headers[index]), self._headers[index], played_round)

    def _read(self, header: BundleHeader) -> FrameBundle:
        try:
            # checksums are verified in the first round only: that takes a pass over all pixels
            is_unverified = header.path not in self._verified
            bundle = read_bundle(header.path, self.recording.camera_ids, mapped=True, checked=is_unverified)
        except RecordingError as err:
            return self._without_frames(header.trigger, err)
        if FrameLossReason.DAMAGED not in bundle.missing.values():
            self._verified.add(header.path)
        return bundle

    def _without_frames(self, trigger: Trigger, error: RecordingError) -> FrameBundle:
        lost = dict.fromkeys(self.recording.camera_ids, FrameLossReason.UNREADABLE)
        return FrameBundle(trigger=trigger, frames={}, missing=lost, unreadable=error.problem)

    def _renumbered(self, bundle: FrameBundle, header: BundleHeader, played_round: int) -> FrameBundle:
        name = header.name
        if played_round == 0:
            return replace(bundle, trigger=replace(bundle.trigger, name=name))
        n_sequences = max(header.sequence for header in self._headers) + 1
        trigger = replace(
            bundle.trigger,
            name=f"{name}-r{played_round + 1}",
            sequence=bundle.trigger.sequence + played_round * n_sequences,
        )
        frames = {
            camera: replace(frame, frame_id=frame.frame_id + played_round * self._n_frame_ids(camera))
            for camera, frame in bundle.frames.items()
        }
        return replace(bundle, trigger=trigger, frames=frames)

    def _n_frame_ids(self, camera: CameraId) -> int:
        ids = [header.frames[camera].frame_id for header in self._headers if camera in header.frames]
        return max(ids) - min(ids) + 1


def _shifted(device_ns: int, shift_ns: int) -> int:
    """Return the shifted time of a device's clock; 0 stands for a device without one."""
    return device_ns + shift_ns if device_ns else 0


def _frame_delay_ns(headers: list[BundleHeader]) -> int:
    """Return the median time from a trigger to its frames."""
    delays_ns = [
        entry.received_ns - header.trigger.received_ns
        for header in headers
        for entry in header.frames.values()
    ]
    return median_low(delays_ns) if delays_ns else FRAME_DELAY_NS
