"""From the light gate and the cameras to the bundles, armed and disarmed on request.

A session arms the cameras, then the gate, pumps the inbox through the assembler, and ends by disarming
the gate first. Every trigger is durable before its bundle is. A device that is lost is brought back
meanwhile; without the gate or with too few cameras the session is held, and what falls is still counted.
"""

import asyncio
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import replace
from typing import Protocol

from drivers.factory import Devices
from drivers.files.times import utc_ago
from drivers.inbox import EventInbox
from drivers.interfaces import CameraLost, DeviceEvent, GateLost, PlaybackEnded
from pipeline.frames import BundleKind, FrameBundle, Trigger
from service.acquisition.device_keeper import Keeper
from service.acquisition.empty_rig import EmptyRigParameters, expose_empty_rig
from service.acquisition.rig_cameras import RigCameras
from service.bundling.assembler import BundleAssembler
from service.bundling.counters import BundlingCounters
from service.bundling.parameters import BundlingParameters
from service.bundling.window import DISARMED
from service.status import AcquisitionState, AcquisitionStatus, AcquisitionTarget, DeviceState, next_state

log = logging.getLogger(__name__)

IDLE_S = 0.05
"""Longest wait for an event before deadlines are looked at."""
STALL_NS = 200_000_000
"""Between two turns of the pump this is no work but the machine, or the disk, standing still."""
LAST_FRAMES_S = 10.0
"""Longest wait for the frames of the last trigger once the gate is disarmed."""
SUSPENDED_S = 60.0
"""Without a stone for so long the crusher is starved or stands: nobody's fault here."""
INBOX_TRIGGERS = 8
"""So many triggers' frames may wait for the loop: at 21 MB each a bound on memory, not a queue."""


class TriggerLog(Protocol):
    """The part of the store that learns of triggers."""

    async def record_triggers(self, session: int, triggers: Mapping[str, Trigger]) -> None: ...


class Acquisition:
    """`run` is its task; `request` arms and disarms, `stop` ends it in order.

    Bundles go to `on_bundle`, in the order of their triggers; `on_progress` is called at every turn of
    the pump. What falls is a ball instead of a stone while `is_ball` says so.
    """

    def __init__(
        self,
        devices: Devices,
        *,
        session: int,
        triggers: TriggerLog,
        bundling: BundlingParameters,
        min_cameras: int,
        empty_rig: EmptyRigParameters = EmptyRigParameters(at_start=0, every_s=0),  # noqa: B008 - frozen
        is_ball: Callable[[], bool] = lambda: False,
        on_bundle: Callable[[FrameBundle], None],
        on_progress: Callable[[], None],
    ) -> None:
        self._devices = devices
        self._session = session
        self._triggers = triggers
        self._bundling = bundling
        self._min_cameras = min(min_cameras, len(devices.cameras))
        self._empty_rig = empty_rig
        self._is_ball = is_ball
        self._on_bundle = on_bundle
        self._on_progress = on_progress
        self._arm_requested = asyncio.Event()
        self._leave = asyncio.Event()
        self._is_abandoned = False
        self._n_named = 0
        self._started_s = self._last_trigger_s = time.monotonic()
        self._last_stone_s: float | None = None
        self.cameras = RigCameras(devices.cameras, clock=devices.clock, is_live=devices.belt is None)
        self.gate = Keeper("light gate", devices.gate)
        self.counters = BundlingCounters()
        """Since it was last armed."""
        self._inbox: EventInbox | None = None
        self._turned_ns: int | None = None  # when the pump last made a turn
        self.state = AcquisitionState.DISARMED
        self.trouble: str | None = None
        """Why it is held."""
        self.settled = asyncio.Event()
        """Set once the first attempt to arm has ended one way or the other."""
        self.is_at_work = False
        """Between the first call to a device and the last one: progress is owed."""

    def request(self, target: AcquisitionTarget) -> AcquisitionState:
        """Begin the transition to `target`; raises `ConflictError`."""
        following = next_state(self.state, target)
        if following is not self.state:
            self.state = following
            if target is AcquisitionTarget.ARMED:
                self._leave.clear()
                self._arm_requested.set()
            else:
                self._leave.set()
        return self.state

    def stop(self) -> None:
        """Disarm for good: `run` returns when everything the cameras saw was handed over."""
        self.state = AcquisitionState.STOPPING
        self._leave.set()
        self._arm_requested.set()

    def abandon(self) -> None:
        """Leave devices that do not come back alone: `run` returns soon."""
        self._is_abandoned = True
        self.gate.abandon()
        self.cameras.abandon()

    def status(self) -> AcquisitionStatus:
        """Return where the rig stands."""
        counters = self.counters
        now_s = time.monotonic()
        is_starved = now_s - (self._last_stone_s or self._started_s) > SUSPENDED_S
        is_armed = self.state is AcquisitionState.ARMED
        return AcquisitionStatus(
            state=self.state,
            trouble=self.trouble,
            activity=("suspended" if is_starved else "measuring") if is_armed else "idle",
            cameras_armed=self.cameras.armed,
            cameras=len(self.cameras.ids),
            gate=self.gate.state,
            gate_error=self.gate.last_error if self.gate.state is DeviceState.LOST else None,
            gate_warnings=self._devices.gate.warnings,
            last_stone_age_s=None if self._last_stone_s is None else round(now_s - self._last_stone_s, 3),
            triggers=counters.triggers,
            orphans=counters.orphans,
            unseen=counters.unseen,
            in_dead_time=counters.in_dead_time,
            triggers_ignored=counters.triggers_ignored,
            triggers_lost=counters.triggers_lost,
            events_refused=0 if self._inbox is None else sum(self._inbox.refused.values()),
        )

    async def run(self) -> None:
        """Arm whenever it is requested."""
        while True:
            await self._arm_requested.wait()
            if self.state is AcquisitionState.STOPPING:
                return
            self._arm_requested.clear()
            if not self._leave.is_set():
                async with asyncio.TaskGroup() as tasks:
                    await self._run_session(tasks)
            self._enter(AcquisitionState.DISARMED)
            self.settled.set()

    def _enter(self, state: AcquisitionState) -> None:
        if self.state is not AcquisitionState.STOPPING:
            self.state = state

    async def _run_session(self, tasks: asyncio.TaskGroup) -> None:
        self._enter(AcquisitionState.ARMING)
        self.is_at_work = True
        inbox = self._inbox = EventInbox(asyncio.get_running_loop(), INBOX_TRIGGERS * len(self.cameras.ids))
        assembler = BundleAssembler(self.cameras.ids, self._bundling)
        self.counters = assembler.counters
        self._turned_ns = None
        self.cameras.count(assembler.counters)
        async with AsyncExitStack() as ending:
            ending.push_async_callback(self._end_session, inbox, assembler)
            ending.push_async_callback(self.cameras.close)
            await self.cameras.arm(inbox, tasks)
            if self._leave.is_set():
                return
            for camera in self.cameras.lost:  # no bundle shall wait for it
                now_ns = self._devices.clock()
                assembler.feed(CameraLost(camera=camera, received_ns=now_ns, reason="not there at the start"))
            self.gate.start(inbox, tasks)
            ending.push_async_callback(self.gate.end)
            ending.push_async_callback(self._pump_last_frames, inbox, assembler)
            ending.push_async_callback(self.gate.disarm)
            await self.gate.settle()
            ending.callback(self._enter, AcquisitionState.DISARMING)
            exposing = tasks.create_task(self._expose_empty_rig(assembler))
            ending.callback(exposing.cancel)
            self._judge()
            self.settled.set()
            log.info("%s cameras=%d of=%d", self.state, self.cameras.armed, len(self.cameras.ids))
            while not self._leave.is_set():
                match await self._pump(inbox, assembler):
                    case GateLost(reason=reason):
                        self.gate.lose(reason)
                    case PlaybackEnded():
                        return
                self._judge()

    def _judge(self) -> None:
        """Whether the next stone will be measured, and if not why."""
        trouble = self.gate.last_error if self.gate.state is DeviceState.LOST else None
        trouble = trouble or self.cameras.trouble(self._min_cameras)
        if trouble and not self.trouble:  # one alarm a cause: what it does to others is not logged again
            log.error("held: %s", trouble)
        elif self.trouble and not trouble:
            log.info("held no longer")
        self.trouble = trouble
        self._enter(AcquisitionState.HELD if trouble else AcquisitionState.ARMED)

    async def _expose_empty_rig(self, assembler: BundleAssembler) -> None:
        async def fire() -> None:
            if self.gate.state is DeviceState.ARMED:
                await self.gate.call(self._devices.gate.test_pulse)

        def is_quiet(for_s: float) -> bool:
            return (
                self.state is AcquisitionState.ARMED
                and assembler.next_deadline_ns is None
                and time.monotonic() - self._last_trigger_s > max(for_s, self._bundling.quiet_s)
            )

        await expose_empty_rig(self._empty_rig, fire, is_quiet)

    async def _pump(self, inbox: EventInbox, assembler: BundleAssembler) -> DeviceEvent | None:
        """Handle and return the next event, or the deadlines that are due if none comes."""
        now_ns = self._devices.clock()  # before asking the inbox, see BundleAssembler
        event = await inbox.get(timeout_s=IDLE_S)
        self._look_for_stall(assembler)
        if event is None:
            bundles = assembler.advance(now_ns)
        else:
            event = self.cameras.vet(event)
            if isinstance(event, Trigger) and not assembler.has_adopted(event):
                (event,) = await self._recorded([event])
            self.cameras.note(event)
            bundles = assembler.feed(event)
        await self._hand_over(bundles)
        self._on_progress()
        return event

    def _look_for_stall(self, assembler: BundleAssembler) -> None:
        """No frame's deadline runs while this process, or the whole machine, stands still."""
        now_ns = time.monotonic_ns()
        stalled_ns = now_ns - (self._turned_ns or now_ns)
        self._turned_ns = now_ns
        if stalled_ns > STALL_NS:
            log.warning("stood still for_s=%.1f", stalled_ns / 1e9)
            assembler.wait_longer(stalled_ns)

    async def _pump_last_frames(self, inbox: EventInbox, assembler: BundleAssembler) -> None:
        """See the stones through that passed the gate before it was disarmed."""
        deadline_s = time.monotonic() + LAST_FRAMES_S
        while time.monotonic() < deadline_s and not self._is_abandoned:
            event = await self._pump(inbox, assembler)
            if event is None and assembler.next_deadline_ns is None:
                return

    async def _end_session(self, inbox: EventInbox, assembler: BundleAssembler) -> None:
        self.is_at_work = False
        self.trouble = None
        await self._hand_over(assembler.flush(DISARMED))
        log.info("disarmed triggers=%d", assembler.counters.triggers)
        if inbox.refused:
            log.error("events lost, the loop was too slow: %s", inbox.refused)

    async def _hand_over(self, bundles: list[FrameBundle]) -> None:
        unannounced = [bundle.trigger for bundle in bundles if not bundle.trigger.is_announced]
        recorded = iter(await self._recorded([self._dated(trigger) for trigger in unannounced]))
        for bundle in bundles:
            if not bundle.trigger.is_announced:
                bundle = replace(bundle, trigger=next(recorded))
                level = logging.DEBUG if self.gate.state is DeviceState.LOST else logging.WARNING
                log.log(
                    level, "stone without an announcement bundle=%s views=%d", bundle.name, len(bundle.frames)
                )
            self.cameras.look_into(bundle)
            self._on_bundle(bundle)
            self._on_progress()

    def _dated(self, trigger: Trigger) -> Trigger:
        return replace(trigger, utc=utc_ago(self._devices.clock() - trigger.received_ns))

    async def _recorded(self, triggers: Sequence[Trigger]) -> list[Trigger]:
        """Make triggers durable, at once: the gate may have counted thousands while it was away."""
        named = {str(trigger.name): trigger for trigger in map(self._named, triggers)}
        if named:
            await self._triggers.record_triggers(self._session, named)
        return list(named.values())

    def _named(self, trigger: Trigger) -> Trigger:
        """The trigger under a name of its own: a gate may count anew at any time."""
        self._last_trigger_s = time.monotonic()
        if trigger.kind is not BundleKind.BACKGROUND:
            self._last_stone_s = self._last_trigger_s
            if self._is_ball():
                trigger = replace(trigger, kind=BundleKind.BALL)
        if trigger.name is not None:
            return trigger
        self._n_named += 1
        suffix = "" if trigger.is_announced else "-orphan"
        return replace(trigger, name=f"{self._n_named:08d}{suffix}")
