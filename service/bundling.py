"""Frames and triggers become bundles: time decides, counters verify. No I/O; time is an argument.

A trigger at time T opens a window of T + expected delay +- `window_ms`; a frame belongs to the trigger in
whose window it arrived, whatever its number. Windows are disjoint because the gate's dead time exceeds
their width. Every trigger leaves as exactly one bundle, in order: complete, or at its deadline with
what is missing. Frame ids only count what was lost.

Events may come in any order within one window's half width; a frame that comes before its trigger waits.
When none comes and most cameras exposed, the frames are a stone that the gate failed to announce: an
orphan, which gets a trigger of its own. A stone that only the gate's counter knows becomes a bundle
without frames.
"""

from bisect import insort
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

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
from service.bundle_counters import BundlingCounters, CameraCounters
from service.frame_checks import ExposureCheck, id_step
from service.missed_triggers import MissedTriggers

NO_FRAME = "no_frame"
"""Nothing came from the camera until the deadline."""
CAMERA_LOST = "camera_lost"
"""The camera does not answer."""
AMBIGUOUS = "ambiguous"
"""Two different frames came for one trigger."""
OTHER_EXPOSURE = "other_exposure"
"""By its camera's clock the frame was exposed for another trigger."""
DEAD_TIME = "dead_time"
"""The trigger followed another within the gate's dead time; the frames belong to the first."""
DISARMED = "disarmed"
"""The session ended before the frame came."""
STONE_PASSED = "stone_passed"
"""The empty rig was exposed while a stone fell."""
UNSEEN = "unseen"
"""The gate counted the trigger and did not announce it, and no camera exposed."""

DELIVERY_NS = 300_000_000
"""So long a frame that arrived in time may take to get here from its camera's thread, on a machine that is busy."""
IN_VIEW_NS = 50_000_000
"""A stone that passes the gate so soon after a test pulse is in the picture, or its edge: it crosses it in 20 ms."""
REMEMBERED_TRIGGERS = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class BundlingParameters:
    """When frames are expected, and how close triggers may follow one another."""

    expected_delay_ms: float = 259.4  # trigger delay 247.4, exposure, transfer
    window_ms: float = 100.0  # half width; more than jitter and packet resends take
    dead_time_ms: float = 220.0  # least time between two triggers, as the gate enforces it

    def __post_init__(self) -> None:
        if not 0 <= self.expected_delay_ms <= 10_000:
            raise ValueError(f"expected_delay_ms must be in 0..10000, not {self.expected_delay_ms:g}")
        if not 1 <= self.window_ms <= 5_000:
            raise ValueError(f"window_ms must be in 1..5000, not {self.window_ms:g}")
        if not self.dead_time_ms > 2 * self.window_ms:
            raise ValueError(
                f"dead_time_ms must exceed twice window_ms, {2 * self.window_ms:g}, not {self.dead_time_ms:g}"
            )

    @property
    def quiet_s(self) -> float:
        """So long after a trigger its stone is through and the cameras are ready for the next."""
        return max(self.dead_time_ms, self.expected_delay_ms) / 1e3 + IN_VIEW_NS / 1e9


@dataclass(slots=True, kw_only=True)
class _Window:
    trigger: Trigger
    ordinal: int  # among triggers that expose
    expected_ns: int
    frames: dict[CameraId, Frame] = field(default_factory=dict)
    lost: dict[CameraId, str] = field(default_factory=dict)
    in_dead_time: bool = False
    is_spoiled: bool = False  # a background with a stone in it
    refused: set[CameraId] = field(default_factory=set)


class _Closed(NamedTuple):
    expected_ns: int
    frame_ids: dict[CameraId, int]


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
        self._open: deque[_Window] = deque()
        self._closed: deque[_Closed] = deque(maxlen=REMEMBERED_TRIGGERS)
        self._held: list[Frame | FrameLost] = []
        self._gone: set[CameraId] = set()
        self._missed = MissedTriggers()
        self._n_exposing = 0
        self._last_sequence = 0
        self._last_trigger: Trigger | None = None  # that exposed
        self._exposures = {camera: ExposureCheck(self._window_ns) for camera in self._camera_ids}
        self._last_used: dict[CameraId, tuple[int, int]] = {}  # frame id, ordinal
        self.counters = BundlingCounters(cameras={camera: CameraCounters() for camera in self._camera_ids})

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
                self._count_unplaced([self._held.pop(0)])
        bundles = []
        while self._open and (self._is_complete(self._open[0]) or now_ns >= self._deadline_ns(self._open[0])):
            bundles.append(self._close(self._open.popleft()))
        return bundles + self._unseen(self._missed.unseen(now_ns))

    def flush(self, reason: str = NO_FRAME) -> list[FrameBundle]:
        """Close everything now; `reason` is that of the frames still expected."""
        self._count_unplaced(self._held)
        self._held = []
        bundles = [self._close(window, reason) for window in self._open]
        self._open.clear()
        return bundles + self._unseen(self._missed.unseen())

    def _announce(self, trigger: Trigger) -> None:
        """Expect the frames of a trigger, unless another one's are on their way."""
        self._missed.announced(trigger.sequence)
        self._last_sequence = trigger.sequence
        last = self._last_trigger
        if last is None or self._spacing_ns(last, trigger) >= self._dead_time_ns:
            self._last_trigger = trigger
            self._open_window(trigger)
            return
        if self._open and self._open[-1].trigger.kind is BundleKind.BACKGROUND:
            apart_ns = self._spacing_ns(self._open[-1].trigger, trigger)
            self._open[-1].is_spoiled |= trigger.kind is not BundleKind.BACKGROUND and apart_ns < IN_VIEW_NS
        self.counters.triggers += 1
        self.counters.in_dead_time += 1
        window = _Window(
            trigger=trigger, ordinal=self._n_exposing, expected_ns=trigger.received_ns + self._delay_ns
        )
        window.in_dead_time = True
        window.lost = dict.fromkeys(self._camera_ids, DEAD_TIME)
        self._open.append(window)

    def _spacing_ns(self, earlier: Trigger, later: Trigger) -> int:
        """By the gate's own clock, which knows no latency, unless that was set anew in between."""
        by_host_ns = later.received_ns - earlier.received_ns
        by_gate_ns = later.device_ns - earlier.device_ns
        has_clock = earlier.device_ns and later.device_ns
        return by_gate_ns if has_clock and abs(by_gate_ns - by_host_ns) < self._window_ns else by_host_ns

    def _open_window(self, trigger: Trigger) -> None:
        self.counters.triggers += 1
        expected_ns = trigger.received_ns + self._delay_ns
        later = [window for window in self._open if window.expected_ns > expected_ns]
        for window in later:
            window.ordinal += 1
        window = _Window(trigger=trigger, ordinal=self._n_exposing - len(later), expected_ns=expected_ns)
        window.lost = dict.fromkeys(self._gone, CAMERA_LOST)
        self._open.insert(len(self._open) - len(later), window)
        self._n_exposing += 1
        self._held = [event for event in self._held if not self._place(event)]

    def _adopt_orphans(self) -> bool:
        """Make up the trigger of the oldest frames that nobody announced, if most cameras have one."""
        expected_ns = self._held[0].received_ns
        exposed = {
            event.camera
            for event in self._held
            if isinstance(event, Frame)
            and self._is_within(event, expected_ns)
            and not self._exposures[event.camera].contradicts(event.device_ns, expected_ns - self._delay_ns)
        }
        announced = [
            *(window.expected_ns for window in self._open),
            *(past.expected_ns for past in self._closed),
        ]
        if 2 * len(exposed) <= len(self._camera_ids) or any(
            abs(expected_ns - other_ns) < self._dead_time_ns for other_ns in announced
        ):
            return False
        self.counters.orphans += 1
        self._missed.adopted()
        trigger = self._unannounced(expected_ns - self._delay_ns)
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
            if not window.in_dead_time and self._is_within(event, window.expected_ns):
                if isinstance(event, Frame):
                    self._take(window, event)
                elif event.camera not in window.frames:
                    window.lost.setdefault(event.camera, event.reason)
                return True
        for expected_ns, frame_ids in self._closed:
            if self._is_within(event, expected_ns):
                if isinstance(event, Frame):
                    self._count_after_close(event, frame_ids)
                return True
        return False

    def _take(self, window: _Window, frame: Frame) -> None:
        counters = self.counters.cameras[frame.camera]
        if window.lost.get(frame.camera) == AMBIGUOUS:
            counters.extra += 1
            return
        known = window.frames.get(frame.camera)
        if known is not None and known.frame_id == frame.frame_id:
            counters.duplicates += 1
            return
        if not self._exposures[frame.camera].belongs(
            frame.device_ns, window.trigger.received_ns, is_first_trigger=window.ordinal == 0
        ):
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

    def _close(self, window: _Window, reason: str = NO_FRAME) -> FrameBundle:
        missing = {}
        for camera in self._camera_ids:
            if window.is_spoiled:
                missing[camera] = STONE_PASSED
                continue
            if camera in window.frames:
                self._verify_id(camera, window.frames[camera].frame_id, window.ordinal)
                self.counters.cameras[camera].used += 1
                continue
            self.counters.cameras[camera].missing += 1
            unexplained = OTHER_EXPOSURE if camera in window.refused else reason
            missing[camera] = window.lost.get(camera, unexplained)
        if missing:
            self.counters.incomplete += 1
        else:
            self.counters.complete += 1
        if not window.in_dead_time:
            frame_ids = {camera: frame.frame_id for camera, frame in window.frames.items()}
            self._closed.append(_Closed(window.expected_ns, frame_ids))
        frames = {
            camera: window.frames[camera]
            for camera in self._camera_ids
            if camera in window.frames and camera not in missing
        }
        return FrameBundle(trigger=window.trigger, frames=frames, missing=missing)

    def _verify_id(self, camera: CameraId, frame_id: int, ordinal: int) -> None:
        """Compare how far the camera's counter went with how many triggers there were."""
        last = self._last_used.get(camera)
        self._last_used[camera] = (frame_id, ordinal)
        if last is None:
            return
        counters = self.counters.cameras[camera]
        n_exposed = id_step(last[0], frame_id)
        if n_exposed is None:
            counters.id_restarts += 1
            return
        n_triggers = ordinal - last[1]
        counters.not_exposed += max(0, n_triggers - n_exposed)
        counters.unannounced += max(0, n_exposed - n_triggers)

    def _count_after_close(self, frame: Frame, frame_ids: dict[CameraId, int]) -> None:
        counters = self.counters.cameras[frame.camera]
        used_id = frame_ids.get(frame.camera)
        if used_id is None:
            counters.late += 1
        elif used_id == frame.frame_id:
            counters.duplicates += 1
        else:
            counters.extra += 1

    def _count_unplaced(self, events: Iterable[Frame | FrameLost]) -> None:
        """Count frames outside of every window: late when the last trigger before lacks it, else strays."""
        before = [*self._closed, *(_Closed(w.expected_ns, dict.fromkeys(w.frames, 0)) for w in self._open)]
        for event in events:
            if not isinstance(event, Frame):
                continue
            counters = self.counters.cameras[event.camera]
            earlier = [window for window in before if window.expected_ns < event.received_ns]
            if earlier and event.camera not in earlier[-1].frame_ids:
                counters.late += 1
            else:
                counters.strays += 1

    def _is_complete(self, window: _Window) -> bool:
        return len(window.frames.keys() | window.lost.keys()) == len(self._camera_ids)

    def _is_within(self, event: Frame | FrameLost, expected_ns: int) -> bool:
        return abs(event.received_ns - expected_ns) <= self._window_ns

    def _deadline_ns(self, window: _Window) -> int:
        return window.expected_ns + self._window_ns + DELIVERY_NS


def _received_ns(event: Frame | FrameLost) -> int:
    return event.received_ns
