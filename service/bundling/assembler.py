"""Assemble frames and triggers into bundles: time decides, counters verify. No I/O; time is an argument.

A trigger at time T opens a window of T + expected delay +- `window_ms`; a frame belongs to the trigger in
whose window it arrived, whatever its number. Windows are disjoint because the gate's dead time exceeds
their width, also of stones that are in the air together: then both are short, and the windows lie close. A frame that
arrives after its window, on a busy machine, still belongs to its trigger while that is open, if its camera's clock and
its counter both say so: neither moves a frame alone. Every trigger leaves as exactly one bundle, in order: complete,
or at its deadline with the reasons of what is missing.

Events may come in any order within one window's half width; a frame that comes before its trigger waits.
When no trigger comes and most cameras exposed, the frames show a stone that the gate failed to announce: an
orphan, which gets a trigger of its own. If the gate announces it after all, that announcement is ignored. A stone
that only the gate's counter knows becomes a bundle without frames.
"""

from bisect import insort
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from itertools import zip_longest
from operator import attrgetter

from drivers.errors import LossCause
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
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, MissingReason, Trigger
from service.bundling.exposure_check import LATEST_FRAME_NS, ExposureCheck, MatchedFrame
from service.bundling.frame_account import REMEMBERED_TRIGGERS, BundlingCounters, CameraCounters, FrameAccount
from service.bundling.missed_triggers import CounterGap, MissedTriggers
from service.bundling.near_stones import NearStones
from service.bundling.window import IN_VIEW_NS, BundlingParameters, OpenTrigger

DELIVERY_NS = 300_000_000
"""Longest delivery of a frame from its camera's thread to the assembler, on a busy machine."""
LATE_NS = 100_000_000
"""Usual lateness on a busy machine: by so much a frame may come before its trigger, or after its short window."""


class BundleAssembler:
    """Turns device events into bundles, on one thread: `feed` it every event, `advance` it at `next_deadline_ns`.

    Read the clock *before* asking the inbox, and if that is empty `advance` to this reading: then
    nothing that was delivered in time can come too late.
    """

    def __init__(self, camera_ids: Iterable[CameraId], parameters: BundlingParameters) -> None:
        self._camera_ids = tuple(camera_ids)
        self._delay_ns = round(parameters.expected_delay_ms * 1e6)
        self._window_ns = round(parameters.window_ms * 1e6)
        self._dead_time_ns = round(parameters.dead_time_ms * 1e6)
        self._open: deque[OpenTrigger] = deque()
        self._unmatched: list[Frame | FrameLost] = []  # waiting for their trigger
        self._lost_cameras: set[CameraId] = set()
        self.missed = MissedTriggers(self._window_ns)
        self._n_exposing = 0
        self._last_sequence = 0
        self._announced: deque[Trigger] = deque(maxlen=REMEMBERED_TRIGGERS)
        self._last_trigger: Trigger | None = None  # outside of the dead time
        self._exposures = {camera: ExposureCheck(self._window_ns) for camera in self._camera_ids}
        self.counters = BundlingCounters(cameras={camera: CameraCounters() for camera in self._camera_ids})
        self._near = NearStones(self._spacing_ns)
        self._account = FrameAccount(self.counters.cameras, self._window_ns)

    @property
    def next_deadline_ns(self) -> int | None:
        """Time to call `advance` at if no event comes before, None while no trigger is open."""
        if not self._open:
            return None
        return self._open[0].expected_ns + self._window_ns + DELIVERY_NS + self._open[0].stalled_ns

    def feed(self, event: DeviceEvent) -> list[FrameBundle]:
        """Process one event; return the bundles that it finished, in the order of their triggers."""
        match event:
            case Trigger():
                self._near.note(event)
                self._announce(event)
            case Frame() | FrameLost():
                if isinstance(event, Frame):
                    self._lost_cameras.discard(event.camera)
                else:
                    self.counters.cameras[event.camera].lost += 1
                if not self._match(event):
                    insort(self._unmatched, event, key=attrgetter("received_ns"))
            case CameraLost():
                self._lost_cameras.add(event.camera)
                if event.cause is not LossCause.PROCESS_ENDED:  # else it kept its power
                    self._exposures[event.camera] = ExposureCheck(self._window_ns)  # its clock may begin anew
                for window in self._open:
                    if event.camera not in window.frames:
                        window.lost.setdefault(event.camera, MissingReason.CAMERA_LOST)
            case CameraBack():
                self._lost_cameras.discard(event.camera)
            case TriggersIgnored():
                self.counters.triggers_ignored += event.count
            case TriggersLost():
                self.counters.triggers_lost += event.count
                due_ns = event.received_ns + self._delay_ns + self._window_ns + DELIVERY_NS
                reason = MissingReason.DOWN if event.while_down else MissingReason.UNSEEN
                self.missed.note_gap(CounterGap(event.received_ns, event.count, reason, due_ns))
            case PulseEnded():
                self._near.note_pulse(event.sequence, event.width_ns)
                for window in self._open:
                    if window.trigger.sequence == event.sequence:
                        window.trigger = replace(window.trigger, pulse_width_ns=event.width_ns)
            case PlaybackEnded():
                return self.flush()
            case GateLost():
                pass
        return self.advance(event.received_ns)

    def advance(self, now_ns: int) -> list[FrameBundle]:
        """Return the bundles of the triggers that are complete or past their deadline."""
        while self._unmatched and now_ns - self._unmatched[0].received_ns > max(self._window_ns, LATE_NS):
            if not self._open_orphan():
                self._account.count_unmatched([self._unmatched.pop(0)], self._open)
        bundles = []
        while (deadline_ns := self.next_deadline_ns) is not None and (
            now_ns >= deadline_ns or self._open[0].is_complete(len(self._camera_ids))
        ):
            bundles.append(self._close(self._open.popleft()))
        return bundles + self._unseen(self.missed.take_unseen(now_ns))

    def extend_deadlines(self, stalled_ns: int) -> None:
        """Postpone the deadlines of all open triggers: while the host stood still, frames were not delivered."""
        for window in self._open:
            window.stalled_ns += stalled_ns

    def flush(self, reason: MissingReason = MissingReason.NO_FRAME) -> list[FrameBundle]:
        """Return the bundles of all open triggers now; `reason` is that of the frames still expected."""
        self._account.count_unmatched(self._unmatched, self._open)
        self._unmatched = []
        bundles = [self._close(window, reason) for window in self._open]
        self._open.clear()
        return bundles + self._unseen(self.missed.take_unseen())

    def has_orphan_of(self, trigger: Trigger) -> bool:
        """True when the stone is an orphan already: the announcement is late and will be ignored."""
        return trigger.kind is not BundleKind.BACKGROUND and self.missed.has_orphan_of(trigger)

    def _announce(self, trigger: Trigger) -> None:
        """Open a window for a trigger, unless it is an orphan already; in the dead time without frames."""
        is_orphan = self.has_orphan_of(trigger)
        self.missed.note_announced(trigger)
        self._last_sequence = trigger.sequence
        self._announced.append(trigger)
        if is_orphan:
            self._last_trigger = trigger
            self.counters.triggers_ignored += 1
            return
        self._spoil_backgrounds(trigger)
        last = self._last_trigger
        if last is None or self._spacing_ns(last, trigger) >= self._dead_time_ns:
            self._last_trigger = trigger
            self._open_window(trigger)
            return
        self.counters.in_dead_time += 1
        self._open_window(trigger, in_dead_time=True)

    def _spoil_backgrounds(self, trigger: Trigger) -> None:
        """Mark open exposures of the empty rig that show the stone of a new trigger."""
        for window in self._open:
            if window.trigger.kind is BundleKind.BACKGROUND and trigger.kind is not BundleKind.BACKGROUND:
                window.is_spoiled |= abs(self._spacing_ns(window.trigger, trigger)) < IN_VIEW_NS

    def _spacing_ns(self, earlier: Trigger, later: Trigger) -> int:
        """Return the time between two triggers by the gate's own clock, by the host's if that was set in between.

        The gate's clock has no latency.
        """
        by_host_ns = later.received_ns - earlier.received_ns
        by_gate_ns = later.device_ns - earlier.device_ns
        has_clock = earlier.device_ns and later.device_ns
        return by_gate_ns if has_clock and abs(by_gate_ns - by_host_ns) < self._window_ns else by_host_ns

    def _open_window(self, trigger: Trigger, *, in_dead_time: bool = False) -> OpenTrigger:
        self.counters.triggers += 1
        expected_ns = trigger.received_ns + self._delay_ns
        later = [window for window in self._open if window.expected_ns > expected_ns]
        window = OpenTrigger(
            trigger=trigger,
            ordinal=self._n_exposing - sum(not window.in_dead_time for window in later),
            expected_ns=expected_ns,
            in_dead_time=in_dead_time,
        )
        self._open.insert(len(self._open) - len(later), window)
        if in_dead_time:
            window.lost = dict.fromkeys(self._camera_ids, MissingReason.DEAD_TIME)
            return window
        window.lost = dict.fromkeys(self._lost_cameras, MissingReason.CAMERA_LOST)
        window.is_spoiled = trigger.kind is BundleKind.BACKGROUND and any(
            other.trigger.kind is not BundleKind.BACKGROUND
            and abs(self._spacing_ns(other.trigger, trigger)) < IN_VIEW_NS
            for other in self._open
            if other is not window
        )
        for later_window in later:
            later_window.ordinal += 1
        self._n_exposing += 1
        self._unmatched = [event for event in self._unmatched if not self._match(event)]
        return window

    def _open_orphan(self) -> bool:
        """Open a window for the oldest unmatched frames if most cameras exposed; return whether they did."""
        expected_ns = self._exposed_ns(self._unmatched[0])
        if expected_ns is None:
            return False
        own = [
            event
            for event in self._unmatched
            if isinstance(event, Frame)
            and (exposed_ns := self._exposed_ns(event)) is not None
            and abs(exposed_ns - expected_ns) <= self._window_ns
        ]
        announced = [*(window.expected_ns for window in self._open), *self._account.closed_ns]
        if 2 * len({frame.camera for frame in own}) <= len(self._camera_ids) or any(
            abs(expected_ns - other_ns) < self._dead_time_ns for other_ns in announced
        ):
            return False
        self.counters.orphans += 1
        trigger = self._unannounced(expected_ns - self._delay_ns)
        self.missed.note_orphan(trigger.received_ns)
        later = [known.sequence for known in self._announced if known.received_ns > trigger.received_ns]
        if later:
            trigger = replace(trigger, sequence=later[0] - 1)
        else:
            self._last_sequence = trigger.sequence
        others = [event for event in self._unmatched if all(event is not frame for frame in own)]
        self._unmatched = []
        window = self._open_window(trigger)
        for frame in own:
            self._add(window, frame)
        self._unmatched = [event for event in others if not self._match(event)]
        return True

    def _exposed_ns(self, event: Frame | FrameLost) -> int | None:
        """Return when a frame without a trigger should have come, by its camera's clock if that is known.

        None when the clock proves that it was exposed long before.
        """
        received_ns = event.received_ns
        if not isinstance(event, Frame):
            return received_ns
        known = self._exposures[event.camera].trigger_ns(event.device_ns)
        if known is None or abs(known[0] - received_ns) > LATEST_FRAME_NS:
            return received_ns  # set anew
        expected_ns, drift_ns = known[0] + self._delay_ns, known[1]
        if not -self._window_ns - drift_ns <= received_ns - expected_ns <= LATE_NS + drift_ns:
            return None
        return expected_ns if drift_ns <= self._window_ns else received_ns

    def _unseen(self, unseen: list[CounterGap]) -> list[FrameBundle]:
        """Return bundles without frames for triggers that only the gate's counter knows."""
        n_unseen = sum(gap.n_triggers for gap in unseen)
        self.counters.triggers += n_unseen
        self.counters.incomplete += n_unseen
        self.counters.unseen += n_unseen
        return [
            FrameBundle(
                trigger=replace(self._unannounced(gap.received_ns), n_stones=gap.n_triggers),
                frames={},
                missing=dict.fromkeys(self._camera_ids, gap.reason),
            )
            for gap in unseen
        ]

    def _unannounced(self, received_ns: int) -> Trigger:
        return Trigger(
            sequence=self._last_sequence + 1, received_ns=received_ns, device_ns=0, utc="", is_announced=False
        )

    def _match(self, event: Frame | FrameLost) -> bool:
        """Give the event to the trigger that it belongs to; return False when there is none yet."""
        exposing = [window for window in self._open if not window.in_dead_time]
        for window, later in zip_longest(exposing, exposing[1:]):
            late_ns = self._window_ns
            if window.ordinal == 0:
                # a camera's first frame cannot be compared with an earlier one: it may come until the next window opens
                late_ns = max(self._dead_time_ns - self._window_ns, LATE_NS)
                if later is not None:
                    late_ns = min(late_ns, later.expected_ns - self._window_ns - window.expected_ns)
            is_within = -self._window_ns <= event.received_ns - window.expected_ns <= late_ns
            if is_within:
                if isinstance(event, Frame):
                    self._add(window, event)
                elif event.camera not in window.frames:
                    window.lost.setdefault(event.camera, event.reason)
                    window.unreadable = event.problem
                return True
        if isinstance(event, Frame) and (owner := self._owner(event)) is not None:
            self._add(owner, event)
            return True
        if isinstance(event, Frame) and (window := self._awaiting(event)) is not None:
            self._add(window, event, is_late=True)
            return True
        frame = event if isinstance(event, Frame) else None
        return self._account.count_after_close(event.camera, event.received_ns, frame)

    def _exposure(self, frame: Frame, window: OpenTrigger) -> MatchedFrame:
        """Return a frame paired with the trigger of a window."""
        exposing_ns = [each.expected_ns for each in self._open if not each.in_dead_time]
        apart_ns = min(
            (
                abs(other_ns - window.expected_ns)
                for other_ns in (*exposing_ns, *self._account.closed_ns)
                if other_ns != window.expected_ns
            ),
            default=LATEST_FRAME_NS,
        )
        return MatchedFrame(
            frame.device_ns, frame.frame_id, window.trigger.received_ns, window.ordinal, apart_ns
        )

    def _awaiting(self, frame: Frame) -> OpenTrigger | None:
        """Return the last trigger before a frame if it waits for this camera, and no later one had its window since."""
        earlier = [window for window in self._open if window.expected_ns < frame.received_ns]
        if not earlier or frame.device_ns == 0:
            return None
        last = earlier[-1]
        is_last = all(
            not last.expected_ns < closed_ns < frame.received_ns for closed_ns in self._account.closed_ns
        )
        is_near = frame.received_ns - last.expected_ns <= self._window_ns + LATE_NS
        waits = not last.in_dead_time and frame.camera not in last.frames.keys() | last.lost.keys()
        if not (is_last and is_near and waits):
            return None
        check = self._exposures[frame.camera]
        known = check.trigger_ns(frame.device_ns)
        is_trusted = known is not None and abs(known[0] - frame.received_ns) <= LATEST_FRAME_NS
        may_be_orphan = is_trusted and self._exposed_ns(frame) is not None
        return last if check.fits(self._exposure(frame, last)) or not may_be_orphan else None

    def _add(self, window: OpenTrigger, frame: Frame, *, is_late: bool = False) -> None:
        """Add a frame to a window unless it is a duplicate or another exposure; two different ones are dropped."""
        counters = self.counters.cameras[frame.camera]
        if window.lost.get(frame.camera) == MissingReason.AMBIGUOUS:
            counters.extra += 1
            return
        known = window.frames.get(frame.camera)
        if known is not None and known.frame_id == frame.frame_id:
            counters.duplicates += 1
            return
        if not self._exposures[frame.camera].belongs(self._exposure(frame, window), is_late=is_late):
            owner = self._owner(frame)
            if owner is not None and owner is not window:
                self._add(owner, frame)
                return
            counters.other_exposure += 1
            window.refused.add(frame.camera)
            return
        if known is not None:
            counters.extra += 2  # neither is used
            del window.frames[frame.camera]
            window.lost[frame.camera] = MissingReason.AMBIGUOUS
            return
        window.lost.pop(frame.camera, None)
        window.frames[frame.camera] = frame

    def _owner(self, frame: Frame) -> OpenTrigger | None:
        """Return the open trigger that a late frame was provably exposed for, None if there is none."""
        check = self._exposures[frame.camera]
        return next(
            (
                window
                for window in self._open
                if not window.in_dead_time
                and window.expected_ns < frame.received_ns
                and check.proves(self._exposure(frame, window))
            ),
            None,
        )

    def _close(self, window: OpenTrigger, reason: MissingReason = MissingReason.NO_FRAME) -> FrameBundle:
        window.trigger = self._near.told(window.trigger)
        bundle = window.bundle(self._camera_ids, reason)
        self._account.count_closed(window, bundle)
        if bundle.missing:
            self.counters.incomplete += 1
        else:
            self.counters.complete += 1
        return bundle
