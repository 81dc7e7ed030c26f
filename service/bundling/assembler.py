"""Frames and triggers become bundles: time decides, counters verify. No I/O; time is an argument.

A trigger at time T opens a window of T + expected delay +- `window_ms`; a frame belongs to the trigger in
whose window it arrived, whatever its number. Windows are disjoint because the gate's dead time exceeds
their width. One that arrives after its window, on a machine that is busy, is its trigger's all the same as
long as that waits, if its camera's own clock and its counter both say so: neither moves a frame alone. Every
trigger leaves as exactly one bundle, in order: complete, or at its deadline with what is missing.

Events may come in any order within one window's half width; a frame that comes before its trigger waits.
When none comes and most cameras exposed, the frames are a stone that the gate failed to announce: an
orphan, which gets a trigger of its own. If the gate's comes after all, it announces nothing new. A stone that
only the gate's counter knows becomes a bundle without frames.
"""

from bisect import insort
from collections import deque
from collections.abc import Iterable
from dataclasses import replace

from drivers.interfaces import (
    CameraBack,
    CameraLost,
    DeviceEvent,
    FrameLost,
    GateLost,
    PlaybackEnded,
    PulseEnded,
    TriggersIgnored,
    TriggersLost,
)
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, Trigger
from service.bundling.counters import BundlingCounters, CameraCounters
from service.bundling.exposure_check import Exposure, ExposureCheck
from service.bundling.frame_account import FrameAccount
from service.bundling.missed_triggers import MissedTriggers
from service.bundling.parameters import IN_VIEW_NS, BundlingParameters
from service.bundling.window import AMBIGUOUS, CAMERA_LOST, DEAD_TIME, NO_FRAME, UNSEEN, Window

DELIVERY_NS = 300_000_000
"""So long a frame that arrived in time may take to get here from its camera's thread, on a machine that is busy."""


class BundleAssembler:
    """Single-threaded; feed it every event of the inbox, and the time at `next_deadline_ns`.

    Read the clock *before* asking the inbox; if that finds nothing, `advance` to the reading: then
    nothing that was delivered in time can come too late.
    """

    def __init__(self, camera_ids: Iterable[CameraId], parameters: BundlingParameters) -> None:
        self._camera_ids = tuple(camera_ids)
        self._delay_ns = round(parameters.expected_delay_ms * 1e6)
        self._window_ns = round(parameters.window_ms * 1e6)
        self._dead_time_ns = round(parameters.dead_time_ms * 1e6)
        self._open: deque[Window] = deque()
        self._held: list[Frame | FrameLost] = []
        self._gone: set[CameraId] = set()
        self._missed = MissedTriggers(self._window_ns)
        self._n_exposing = 0
        self._last_sequence = 0
        self._last_trigger: Trigger | None = None  # that exposed
        self._exposures = {camera: ExposureCheck(self._window_ns) for camera in self._camera_ids}
        self.counters = BundlingCounters(cameras={camera: CameraCounters() for camera in self._camera_ids})
        self._account = FrameAccount(self.counters.cameras, self._window_ns)

    @property
    def next_deadline_ns(self) -> int | None:
        """When to call `advance` if no event comes before."""
        return self._deadline_ns(self._open[0]) if self._open else None

    def feed(self, event: DeviceEvent) -> list[FrameBundle]:
        """Take one event; returns the bundles it finished, in the order of their triggers."""
        match event:
            case Trigger():
                self._announce(event)
            case Frame() | FrameLost():
                if isinstance(event, Frame):
                    self._gone.discard(event.camera)
                else:
                    self.counters.cameras[event.camera].lost += 1
                if not self._place(event):
                    insort(self._held, event, key=_received_ns)
            case CameraLost():
                self._gone.add(event.camera)
                self._exposures[event.camera] = ExposureCheck(self._window_ns)  # its clock may begin anew
                for window in self._open:
                    if event.camera not in window.frames:
                        window.lost.setdefault(event.camera, CAMERA_LOST)
            case CameraBack():
                self._gone.discard(event.camera)
            case TriggersIgnored():
                self.counters.triggers_ignored += event.count
            case TriggersLost():
                self.counters.triggers_lost += event.count
                due_ns = event.received_ns + self._delay_ns + self._window_ns + DELIVERY_NS
                self._missed.missed(event.count, event.received_ns, due_ns)
            case PulseEnded():
                for window in self._open:
                    if window.trigger.sequence == event.sequence:
                        window.trigger = replace(window.trigger, pulse_width_ns=event.width_ns)
            case PlaybackEnded():
                return self.flush()
            case GateLost():
                pass
        return self.advance(event.received_ns)

    def advance(self, now_ns: int) -> list[FrameBundle]:
        """Close what is complete or past its deadline."""
        while self._held and now_ns - self._held[0].received_ns > self._window_ns:
            if not self._adopt_orphans():
                self._give_up([self._held.pop(0)])
        bundles = []
        n_cameras = len(self._camera_ids)
        while self._open and (
            self._open[0].is_complete(n_cameras) or now_ns >= self._deadline_ns(self._open[0])
        ):
            bundles.append(self._close(self._open.popleft()))
        return bundles + self._unseen(self._missed.unseen(now_ns))

    def wait_longer(self, stalled_ns: int) -> None:
        """The host stood still for so long: frames of the open triggers may be here, and not yet delivered."""
        for window in self._open:
            window.stalled_ns += stalled_ns

    def flush(self, reason: str = NO_FRAME) -> list[FrameBundle]:
        """Close everything now; `reason` is that of the frames still expected."""
        self._give_up(self._held)
        self._held = []
        bundles = [self._close(window, reason) for window in self._open]
        self._open.clear()
        return bundles + self._unseen(self._missed.unseen())

    def has_adopted(self, trigger: Trigger) -> bool:
        """Whether the frames of a stone have a trigger already: the line that announces it is late, and ignored."""
        return trigger.kind is not BundleKind.BACKGROUND and self._missed.has_adopted(trigger)

    def _announce(self, trigger: Trigger) -> None:
        """Expect the frames of a trigger, unless they are here already or another one's are on their way."""
        is_here = self.has_adopted(trigger)
        self._missed.announced(trigger)
        self._last_sequence = trigger.sequence
        if is_here:
            self._last_trigger = trigger
            self.counters.triggers_ignored += 1
            return
        last = self._last_trigger
        if last is None or self._spacing_ns(last, trigger) >= self._dead_time_ns:
            self._last_trigger = trigger
            self._open_window(trigger)
            return
        self.counters.in_dead_time += 1
        if self._open and self._open[-1].trigger.kind is BundleKind.BACKGROUND:
            apart_ns = self._spacing_ns(self._open[-1].trigger, trigger)
            self._open[-1].is_spoiled |= trigger.kind is not BundleKind.BACKGROUND and apart_ns < IN_VIEW_NS
        self._open_window(trigger, in_dead_time=True)

    def _spacing_ns(self, earlier: Trigger, later: Trigger) -> int:
        """By the gate's own clock, which knows no latency, unless that was set anew in between."""
        by_host_ns = later.received_ns - earlier.received_ns
        by_gate_ns = later.device_ns - earlier.device_ns
        has_clock = earlier.device_ns and later.device_ns
        return by_gate_ns if has_clock and abs(by_gate_ns - by_host_ns) < self._window_ns else by_host_ns

    def _open_window(self, trigger: Trigger, *, in_dead_time: bool = False) -> None:
        self.counters.triggers += 1
        expected_ns = trigger.received_ns + self._delay_ns
        later = [window for window in self._open if window.expected_ns > expected_ns]
        window = Window(
            trigger=trigger,
            ordinal=self._n_exposing - sum(not window.in_dead_time for window in later),
            expected_ns=expected_ns,
            in_dead_time=in_dead_time,
        )
        self._open.insert(len(self._open) - len(later), window)
        if in_dead_time:
            window.lost = dict.fromkeys(self._camera_ids, DEAD_TIME)
            return
        window.lost = dict.fromkeys(self._gone, CAMERA_LOST)
        for each in later:
            each.ordinal += 1
        self._n_exposing += 1
        self._held = [event for event in self._held if not self._place(event)]

    def _adopt_orphans(self) -> bool:
        """Make up the trigger of the oldest frames that nobody announced, if most cameras have one."""
        expected_ns = self._held[0].received_ns
        exposed = {
            event.camera
            for event in self._held
            if isinstance(event, Frame)
            and abs(event.received_ns - expected_ns) <= self._window_ns
            and not self._exposures[event.camera].contradicts(event.device_ns, expected_ns - self._delay_ns)
        }
        announced = [*(window.expected_ns for window in self._open), *self._account.closed_ns]
        if 2 * len(exposed) <= len(self._camera_ids) or any(
            abs(expected_ns - other_ns) < self._dead_time_ns for other_ns in announced
        ):
            return False
        self.counters.orphans += 1
        trigger = self._unannounced(expected_ns - self._delay_ns)
        self._missed.adopted(trigger.received_ns)
        later = next((window.trigger for window in self._open if window.expected_ns > expected_ns), None)
        if later is not None:
            trigger = replace(trigger, sequence=later.sequence - 1)
        else:
            self._last_sequence = trigger.sequence
        self._open_window(trigger)
        return True

    def _unseen(self, told_ns: list[int]) -> list[FrameBundle]:
        """Bundles without frames for what only the gate's counter knows."""
        self.counters.triggers += len(told_ns)
        self.counters.incomplete += len(told_ns)
        self.counters.unseen += len(told_ns)
        missing = dict.fromkeys(self._camera_ids, UNSEEN)
        return [
            FrameBundle(trigger=self._unannounced(received_ns), frames={}, missing=missing)
            for received_ns in told_ns
        ]

    def _unannounced(self, received_ns: int) -> Trigger:
        return Trigger(
            sequence=self._last_sequence + 1, received_ns=received_ns, device_ns=0, utc="", is_announced=False
        )

    def _place(self, event: Frame | FrameLost) -> bool:
        """Give the event to the trigger in whose window it came; false when there is none yet."""
        for window in self._open:
            # a camera's first frame has no earlier one to be compared with: it may come until the next window opens
            late_ns = self._dead_time_ns - self._window_ns if window.ordinal == 0 else self._window_ns
            is_within = -self._window_ns <= event.received_ns - window.expected_ns <= late_ns
            if not window.in_dead_time and is_within:
                if isinstance(event, Frame):
                    self._take(window, event)
                elif event.camera not in window.frames:
                    window.lost.setdefault(event.camera, event.reason)
                    window.unreadable = event.problem
                return True
        if isinstance(event, Frame) and (owner := self._owner(event)) is not None:
            self._take(owner, event)
            return True
        frame = event if isinstance(event, Frame) else None
        return self._account.comes_after_close(event.camera, event.received_ns, frame)

    def _take(self, window: Window, frame: Frame) -> None:
        counters = self.counters.cameras[frame.camera]
        if window.lost.get(frame.camera) == AMBIGUOUS:
            counters.extra += 1
            return
        known = window.frames.get(frame.camera)
        if known is not None and known.frame_id == frame.frame_id:
            counters.duplicates += 1
            return
        if not self._exposures[frame.camera].belongs(_exposure(frame, window)):
            owner = self._owner(frame)
            if owner is not None and owner is not window:
                self._take(owner, frame)
                return
            counters.other_exposure += 1
            window.refused.add(frame.camera)
            return
        if known is not None:
            counters.extra += 2  # neither is used
            del window.frames[frame.camera]
            window.lost[frame.camera] = AMBIGUOUS
            return
        window.lost.pop(frame.camera, None)
        window.frames[frame.camera] = frame

    def _owner(self, frame: Frame) -> Window | None:
        """The trigger that a frame which comes too late was exposed for, while it waits."""
        check = self._exposures[frame.camera]
        return next(
            (
                window
                for window in self._open
                if not window.in_dead_time
                and window.expected_ns < frame.received_ns
                and check.proves(_exposure(frame, window))
            ),
            None,
        )

    def _close(self, window: Window, reason: str = NO_FRAME) -> FrameBundle:
        bundle = window.bundle(self._camera_ids, reason)
        self._account.close(window, bundle)
        if bundle.missing:
            self.counters.incomplete += 1
        else:
            self.counters.complete += 1
        return bundle

    def _give_up(self, events: Iterable[Frame | FrameLost]) -> None:
        """Let go of what came without a trigger."""
        self._account.unplaced([event for event in events if isinstance(event, Frame)], self._open)

    def _deadline_ns(self, window: Window) -> int:
        return window.expected_ns + self._window_ns + DELIVERY_NS + window.stalled_ns


def _exposure(frame: Frame, window: Window) -> Exposure:
    return Exposure(frame.device_ns, frame.frame_id, window.trigger.received_ns, window.ordinal)


def _received_ns(event: Frame | FrameLost) -> int:
    return event.received_ns
