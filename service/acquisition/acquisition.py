"""Acquire bundles from the light gate and the cameras; armed and disarmed on request.

Arming starts the cameras, then the gate; while armed, events are pumped from the inbox through the assembler; disarming
stops the gate first. Every trigger is durable before its bundle is handed over. A device that is lost is brought back
meanwhile; without the gate or with too few cameras, or while nothing can be stored, the acquisition is held, and stones
are still counted.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import asdict, dataclass, replace

from drivers.factory import Devices
from drivers.files.times import utc_ago
from drivers.inbox import EventInbox
from drivers.interfaces import CameraLost, CameraVitals, DeviceEvent, GateLost, PlaybackEnded, TriggersLost
from pipeline.frames import CameraId, FrameBundle, MissingReason, Trigger
from service.acquisition.device_keeper import DeviceKeeper
from service.acquisition.empty_rig import EmptyRigParameters, expose_empty_rig
from service.acquisition.gate_watch import GateWatch
from service.acquisition.rig_cameras import RigCameras, camera_checks, device_check
from service.acquisition.shown_camera import ShownCamera
from service.acquisition.triggers import TriggerLog, Triggers
from service.base.status import (
    AcquisitionState,
    AcquisitionStatus,
    AcquisitionTarget,
    Checks,
    DeviceState,
    NotDisarmedError,
    next_state,
)
from service.bundling.assembler import BundleAssembler
from service.bundling.frame_account import BundlingCounters
from service.bundling.window import BundlingParameters

log = logging.getLogger(__name__)

IDLE_S = 0.05
"""Longest wait for an event before deadlines are checked."""
STALL_NS = 200_000_000
"""A longer time between two turns of the pump means that the machine, or its disk, stood still."""
LAST_FRAMES_S = 10.0
"""Longest wait for the frames of the last trigger once the gate is disarmed."""
SUSPENDED_S = 60.0
"""Time without a stone after which the crusher is taken to be starved or standing, which is no fault of the rig."""
INBOX_TRIGGERS = 8
"""Triggers whose frames may wait in the inbox: at 21 MB each this bounds the memory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AcquisitionParameters:
    """Parameters of the acquisition in one session."""

    session: int
    bundling: BundlingParameters
    min_cameras: int
    empty_rig: EmptyRigParameters


class Acquisition:
    """Runs the rig: `run` is its task, `request` arms and disarms it, `stop` ends it in order.

    Bundles are passed to `on_bundle` in the order of their triggers; `on_progress` is called at every turn of
    the pump, `on_state` with each new state, and why it is held. While triggers cannot be recorded, it is held.
    """

    def __init__(
        self,
        devices: Devices,
        parameters: AcquisitionParameters,
        *,
        triggers: TriggerLog | None = None,
        is_ball: Callable[[], bool] = lambda: False,
        on_bundle: Callable[[FrameBundle], None],
        on_progress: Callable[[], None] = lambda: None,
        on_state: Callable[[AcquisitionState, str | None], None] = lambda state, trouble: None,
    ) -> None:
        self._devices = devices
        self._parameters = parameters
        self._triggers = Triggers(triggers, parameters.session, is_ball)
        self._min_cameras = min(parameters.min_cameras, len(devices.cameras))
        self._on_bundle = on_bundle
        self._on_progress = on_progress
        self._on_state = on_state
        self._arm_requested = asyncio.Event()
        self._disarm_requested = asyncio.Event()
        self._is_abandoned = False
        self._started_s = time.monotonic()
        self.cameras = RigCameras(devices.cameras, clock=devices.clock, is_live=devices.belt is None)
        self.gate = DeviceKeeper("light gate", devices.gate)
        self._shown_camera = ShownCamera()
        self._using_cameras = asyncio.Lock()
        """Held while it is decided who may open cameras: the armed rig, or `show_camera`."""
        self._gate_watch = GateWatch(parameters.bundling)
        self.counters = BundlingCounters()
        """Counts since the rig was last armed."""
        self._inbox: EventInbox | None = None
        self._last_turn_ns: int | None = None  # of the pump
        self.state = AcquisitionState.DISARMED
        self.trouble: str | None = None
        """Why the acquisition is held, None when it is not."""
        self.settled = asyncio.Event()
        """Set once the first attempt to arm has succeeded or failed."""
        self.is_active = False
        """Whether devices are in use, so that progress is expected of `run`."""

    def request(self, target: AcquisitionTarget) -> AcquisitionState:
        """Begin the transition to `target` and return the new state; raise `ConflictError` if it is not allowed."""
        following = next_state(self.state, target)
        if following is not self.state:
            self._enter(following)
            if target is AcquisitionTarget.ARMED:
                self._disarm_requested.clear()
                self._arm_requested.set()
            else:
                self._disarm_requested.set()
        return self.state

    async def show_camera(self, name: CameraId, seconds: float) -> CameraVitals:
        """Let the lamp of one camera blink for some seconds, or until the rig is armed; return how the camera is.

        Raises `NotDisarmedError` while the acquisition uses the cameras, `CameraUnavailableError` as `ShownCamera`.
        """
        async with self._using_cameras:
            if self.state is not AcquisitionState.DISARMED:
                raise NotDisarmedError(self.state)
            return await self._shown_camera.show(self._devices.cameras[name], seconds)

    def stop(self) -> None:
        """Disarm for good: `run` returns when every bundle has been handed over."""
        self._enter(AcquisitionState.STOPPING)
        self._disarm_requested.set()
        self._arm_requested.set()

    def abandon(self) -> None:
        """Stop waiting for devices and for frames: `run` returns soon."""
        self._is_abandoned = True
        self.gate.abandon()
        self.cameras.abandon()

    def status(self) -> AcquisitionStatus:
        """Return state and counters of the rig."""
        counters = asdict(self.counters)
        del counters["cameras"]
        now_s, last_stone_s = time.monotonic(), self._triggers.last_stone_s
        is_starved = now_s - (last_stone_s or self._started_s) > SUSPENDED_S
        is_armed = self.state is AcquisitionState.ARMED
        return AcquisitionStatus(
            state=self.state,
            trouble=self.trouble,
            activity=("suspended" if is_starved else "measuring") if is_armed else "idle",
            cameras_armed=self.cameras.armed,
            cameras=len(self.cameras.ids),
            gate=self.gate.state,
            gate_error=self.gate.last_error if self.gate.state is DeviceState.LOST else None,
            gate_warnings=(*self._devices.gate.warnings, *self._gate_watch.warnings(now_s)),
            last_stone_age_s=None if last_stone_s is None else round(now_s - last_stone_s, 3),
            **counters,
            events_refused=0 if self._inbox is None else sum(self._inbox.refused.values()),
        )

    def checks(self) -> Checks:
        """Return the checks of all devices."""
        rig, cameras = self.status(), self.cameras
        of_cameras = camera_checks(
            cameras.statuses(),
            common_cause=cameras.common_cause,
            process=self._devices.camera_process(),
            blind_triggers=cameras.blind_triggers,
        )
        return {**of_cameras, "gate": device_check(rig.gate, rig.gate_error, rig.gate_warnings)}

    async def run(self) -> None:
        """Arm whenever it is requested, until `stop`."""
        while True:
            await self._arm_requested.wait()
            async with self._using_cameras:
                await self._shown_camera.end()
            if self.state is AcquisitionState.STOPPING:
                return
            self._arm_requested.clear()
            if not self._disarm_requested.is_set():
                async with asyncio.TaskGroup() as tasks:
                    await self._run_armed(tasks)
                await self._triggers.forget_gate_count()
            self._enter(AcquisitionState.DISARMED)
            self.settled.set()

    def _enter(self, state: AcquisitionState) -> None:
        """Enter a state; after `STOPPING` there is none."""
        if self.state not in (state, AcquisitionState.STOPPING):
            self.state = state
            self._on_state(state, self.trouble if state is AcquisitionState.HELD else None)

    async def _run_armed(self, tasks: asyncio.TaskGroup) -> None:
        """Arm the rig and pump events until disarming is requested; the exit stack disarms in reverse order."""
        self._enter(AcquisitionState.ARMING)
        self.is_active = True
        inbox = self._inbox = EventInbox(asyncio.get_running_loop(), INBOX_TRIGGERS * len(self.cameras.ids))
        assembler = BundleAssembler(self.cameras.ids, self._parameters.bundling)
        self.counters = assembler.counters
        self._last_turn_ns = None
        self.cameras.use_counters(assembler.counters)
        async with AsyncExitStack() as ending:
            ending.push_async_callback(self._end_armed, inbox, assembler)
            ending.push_async_callback(self.cameras.close)
            await self.cameras.arm(inbox, tasks)
            if self._disarm_requested.is_set():
                return
            for camera in self.cameras.lost:  # bundles do not wait for it
                now_ns = self._devices.clock()
                assembler.feed(CameraLost(camera=camera, received_ns=now_ns, reason="not there at the start"))
            self.gate.start(inbox, tasks)
            ending.push_async_callback(self.gate.close)
            ending.push_async_callback(self._pump_last_frames, inbox, assembler)
            ending.push_async_callback(self.gate.disarm)
            await self.gate.tried.wait()
            ending.callback(self._enter, AcquisitionState.DISARMING)
            exposing = tasks.create_task(self._expose_empty_rig(assembler))
            ending.callback(exposing.cancel)
            self._hold_or_release()
            self.settled.set()
            log.info("%s cameras=%d of=%d", self.state, self.cameras.armed, len(self.cameras.ids))
            while not self._disarm_requested.is_set():
                match await self._pump(inbox, assembler):
                    case GateLost(reason=reason):
                        self.gate.mark_lost(reason)
                    case PlaybackEnded():
                        return
                self._hold_or_release()

    def _hold_or_release(self) -> None:
        """Set the state to held or armed, depending on whether the next stone can be measured."""
        trouble = self.gate.last_error if self.gate.state is DeviceState.LOST else None
        trouble = trouble or self.cameras.trouble(self._min_cameras) or self._triggers.trouble
        if trouble and not self.trouble:  # one alarm a cause: its consequences are not logged
            log.error("acquisition held: %s", trouble)
        elif self.trouble and not trouble:
            log.info("acquisition held no longer")
        self.trouble = trouble
        self._enter(AcquisitionState.HELD if trouble else AcquisitionState.ARMED)

    async def _expose_empty_rig(self, assembler: BundleAssembler) -> None:
        quiet_s = self._parameters.bundling.quiet_s

        async def fire() -> None:
            if self.gate.state is DeviceState.ARMED:
                await self.gate.call(self._devices.gate.test_pulse)

        def is_quiet(for_s: float) -> bool:
            is_idle = self.state is AcquisitionState.ARMED and assembler.next_deadline_ns is None
            return is_idle and time.monotonic() - self._triggers.last_s > max(for_s, quiet_s)

        await expose_empty_rig(self._parameters.empty_rig, fire, is_quiet)

    async def _pump(self, inbox: EventInbox, assembler: BundleAssembler) -> DeviceEvent | None:
        """Handle and return the next event; if none comes, close the bundles that are due and return None."""
        now_ns = self._devices.clock()  # before asking the inbox, see BundleAssembler
        event = await inbox.get(timeout_s=IDLE_S)
        turn_ns, last_turn_ns = time.monotonic_ns(), self._last_turn_ns
        self._last_turn_ns = turn_ns
        if last_turn_ns is not None and turn_ns - last_turn_ns > STALL_NS:
            log.warning("the process stood still for_s=%.1f", (turn_ns - last_turn_ns) / 1e9)
            assembler.extend_deadlines(turn_ns - last_turn_ns)
        if event is None:
            bundles = assembler.advance(now_ns)
        else:
            event = self.cameras.refuse_repeated(event)
            match event:
                case Trigger() if assembler.has_orphan_of(event):
                    self._gate_watch.note_late(time.monotonic())
                case Trigger():
                    count = None if assembler.missed.has_gap else event.gate_count
                    (event,) = await self._triggers.record([event], count)
                    log.debug("the beam closed trigger=%d bundle=%s", event.sequence, event.name)
                case TriggersLost():
                    log.warning("stones without an announcement count=%d: %s", event.count, event.reason)
                    self._gate_watch.note_gap(event, time.monotonic())
            self.cameras.track(event)
            bundles = assembler.feed(event)
        await self._hand_over(bundles)
        self._on_progress()
        return event

    async def _pump_last_frames(self, inbox: EventInbox, assembler: BundleAssembler) -> None:
        """Pump events until every stone that passed the gate has its bundle."""
        deadline_s = time.monotonic() + LAST_FRAMES_S
        while time.monotonic() < deadline_s and not self._is_abandoned:
            event = await self._pump(inbox, assembler)
            if event is None and assembler.next_deadline_ns is None:
                return

    async def _end_armed(self, inbox: EventInbox, assembler: BundleAssembler) -> None:
        """Hand over what is left when all devices are closed."""
        self.is_active = False
        self.trouble = None
        await self._hand_over(assembler.flush(MissingReason.DISARMED))
        log.info("disarmed triggers=%d", assembler.counters.triggers)
        if inbox.refused:
            log.error("events lost, the loop was too slow: %s", inbox.refused)

    async def _hand_over(self, bundles: list[FrameBundle]) -> None:
        """Pass bundles on; triggers that the gate did not announce are recorded first."""
        now_ns = self._devices.clock()
        unannounced = [bundle.trigger for bundle in bundles if not bundle.trigger.is_announced]
        dated = [replace(trigger, utc=utc_ago(now_ns - trigger.received_ns)) for trigger in unannounced]
        recorded = iter(await self._triggers.record(dated))
        for bundle in bundles:
            if not bundle.trigger.is_announced:
                bundle = replace(bundle, trigger=next(recorded))
                log.log(
                    logging.DEBUG if self.gate.state is DeviceState.LOST else logging.WARNING,
                    "stone without an announcement bundle=%s views=%d stones=%d",
                    bundle.name,
                    len(bundle.frames),
                    bundle.trigger.n_stones,
                )
            if log.isEnabledFor(logging.DEBUG):
                for camera, reason in bundle.missing.items():
                    log.debug("no frame: %s camera=%s bundle=%s", reason, camera, bundle.name)
                log.debug(
                    "bundle of %d views trigger=%d bundle=%s",
                    len(bundle.frames),
                    bundle.trigger.sequence,
                    bundle.name,
                )
            self.cameras.check_bundle(bundle)
            if self.gate.state is not DeviceState.LOST:
                self._gate_watch.note_bundle(bundle, time.monotonic())
            self._on_bundle(bundle)
            self._on_progress()
