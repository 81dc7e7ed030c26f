"""From the light gate and the cameras to the bundles, armed and disarmed on request.

A session opens and arms the cameras, then the gate, pumps the inbox through the assembler, and ends by
disarming the gate first. Every trigger is durable before its bundle is. A lost camera degrades the
results; a lost gate, or too few cameras, ends the session, which is started anew.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import replace
from typing import Protocol

from drivers.errors import CameraUnavailableError, DeviceError, GateUnavailableError
from drivers.factory import Devices
from drivers.inbox import EventInbox
from drivers.interfaces import CameraLost, DeviceEvent, GateLost, PlaybackEnded
from pipeline.frames import FrameBundle, Trigger
from service.bundling import BundleAssembler, BundlingParameters
from service.control import AcquisitionState, AcquisitionTarget, next_state
from service.rig_cameras import RigCameras, is_set_within
from service.supervision import RestartPolicy, supervise

log = logging.getLogger(__name__)

IDLE_S = 0.05
"""Longest wait for an event before deadlines are looked at."""
LAST_FRAMES_S = 10.0
"""Longest wait for the frames of the last trigger once the gate is disarmed."""
INBOX_TRIGGERS = 8
"""So many triggers' frames may wait for the loop: at 21 MB each a bound on memory, not a queue."""


class TriggerLog(Protocol):
    """The part of the store that learns of triggers."""

    async def record_trigger(self, session: int, trigger: Trigger, bundle: str) -> None: ...


class Acquisition:
    """`run` is its task; `request` arms and disarms, `stop` ends it in order.

    Bundles go to `on_bundle`, in the order of their triggers; `on_progress` is called at every turn of
    the pump.
    """

    def __init__(
        self,
        devices: Devices,
        *,
        session: int,
        triggers: TriggerLog,
        bundling: BundlingParameters,
        min_cameras: int,
        policy: RestartPolicy,
        on_bundle: Callable[[FrameBundle], None],
        on_progress: Callable[[], None],
    ) -> None:
        self._devices = devices
        self._session = session
        self._triggers = triggers
        self._bundling = bundling
        self._min_cameras = min(min_cameras, len(devices.cameras))
        self._policy = policy
        self._on_bundle = on_bundle
        self._on_progress = on_progress
        self._arm_requested = asyncio.Event()
        self._leave = asyncio.Event()
        self._armings = 0
        self.cameras = RigCameras(devices.cameras)
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

    async def run(self) -> None:
        """Arm whenever it is requested.

        Raises
        ------
        DeviceError
            The rig failed more often than the policy allows.
        """
        while True:
            await self._arm_requested.wait()
            if self.state is AcquisitionState.STOPPING:
                return
            self._arm_requested.clear()
            await supervise("acquisition", self._run_session, DeviceError, self._policy, pause=self._hold)
            self._enter(AcquisitionState.DISARMED)
            self.settled.set()

    def _enter(self, state: AcquisitionState) -> None:
        if self.state is not AcquisitionState.STOPPING:
            self.state = state

    async def _hold(self, error: Exception, delay_s: float) -> None:
        self.trouble = str(error)
        self._enter(AcquisitionState.HELD)
        self.settled.set()
        await is_set_within(self._leave, delay_s)

    async def _run_session(self) -> None:
        if self._leave.is_set():
            return
        self._enter(AcquisitionState.ARMING)
        self._armings += 1
        self.is_at_work = True
        gate = self._devices.gate
        inbox = EventInbox(asyncio.get_running_loop(), INBOX_TRIGGERS * len(self.cameras.ids))
        assembler = BundleAssembler(self.cameras.ids, self._bundling)
        self.cameras.count(assembler.counters)
        async with AsyncExitStack() as ending:
            ending.callback(self._end_session, inbox, assembler)
            ending.push_async_callback(self.cameras.close)
            await self.cameras.arm(inbox)
            self._require_cameras()
            retrying = self._retry_lost_cameras(inbox, ending)
            ending.push_async_callback(asyncio.to_thread, gate.close)
            await asyncio.to_thread(gate.open)
            ending.push_async_callback(self._pump_last_frames, inbox, assembler)
            ending.push_async_callback(asyncio.to_thread, gate.disarm)
            await asyncio.to_thread(gate.arm, inbox)
            ending.callback(self._enter, AcquisitionState.DISARMING)
            self._enter(AcquisitionState.ARMED)
            self.trouble = None
            self.settled.set()
            log.info("armed cameras=%d of=%d", self.cameras.armed, len(self.cameras.ids))
            while not self._leave.is_set() and not retrying.done():
                match await self._pump(inbox, assembler):
                    case GateLost(reason=reason):
                        raise GateUnavailableError("light gate", reason)
                    case CameraLost():
                        self._require_cameras()
                    case PlaybackEnded():
                        return

    def _retry_lost_cameras(self, inbox: EventInbox, ending: AsyncExitStack) -> "asyncio.Task[None]":
        leave = asyncio.Event()
        retrying = asyncio.create_task(self.cameras.retry_lost(inbox, leave))

        async def end() -> None:
            leave.set()
            await retrying

        ending.push_async_callback(end)
        return retrying

    def _require_cameras(self) -> None:
        if self.cameras.armed < self._min_cameras:
            lost = [status for status in self.cameras.statuses() if status.state == "lost"]
            raise CameraUnavailableError(
                ", ".join(status.id for status in lost),
                f"{lost[0].last_error}; {self.cameras.armed} cameras are left of {self._min_cameras} needed",
            )

    async def _pump(self, inbox: EventInbox, assembler: BundleAssembler) -> DeviceEvent | None:
        """Handle and return the next event, or the deadlines that are due if none comes."""
        now_ns = self._devices.clock()  # before asking the inbox, see BundleAssembler
        event = await inbox.get(timeout_s=IDLE_S)
        if event is None:
            bundles = assembler.advance(now_ns)
        else:
            if isinstance(event, Trigger):
                event = await self._recorded(event)
            self.cameras.note(event)
            bundles = assembler.feed(event)
        for bundle in bundles:
            self._on_bundle(bundle)
        self._on_progress()
        return event

    async def _pump_last_frames(self, inbox: EventInbox, assembler: BundleAssembler) -> None:
        """See the stones through that passed the gate before it was disarmed."""
        deadline_s = time.monotonic() + LAST_FRAMES_S
        while time.monotonic() < deadline_s:
            event = await self._pump(inbox, assembler)
            if event is None and assembler.next_deadline_ns is None:
                return

    def _end_session(self, inbox: EventInbox, assembler: BundleAssembler) -> None:
        self.is_at_work = False
        for bundle in assembler.flush("disarmed"):
            self._on_bundle(bundle)
        log.info("disarmed triggers=%d", assembler.counters.triggers)
        if inbox.refused:
            log.error("events lost, the loop was too slow: %s", inbox.refused)

    async def _recorded(self, trigger: Trigger) -> Trigger:
        """Make the trigger durable; a live gate may count anew with every arming, names may not."""
        name = trigger.name
        if name is None:
            name = f"{trigger.sequence:08d}" + (f"~{self._armings}" if self._armings > 1 else "")
            trigger = replace(trigger, name=name)
        await self._triggers.record_trigger(self._session, trigger, name)
        return trigger
