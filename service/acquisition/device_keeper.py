"""Keep one device armed: open it, arm it, examine it, and bring it back whenever it is lost.

Device calls block for seconds (a GigE control call takes 2.5 s to fail), so each device has a thread of
its own: a dead device delays no other.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from drivers.errors import DeviceError, LossCause, Told
from drivers.interfaces import Camera, CameraVitals, EventSink, LightGate
from service.base.messages import Code, CodedText, findings_of, message
from service.base.status import DeviceState

log = logging.getLogger(__name__)

BACK_OFF_S = (0.5, 1.0, 2.0, 4.0, 5.0)
"""Waits between attempts to bring a device back; the last one is repeated without end.

Not tenacity or stamina: these retry one call, while this wait ends early when the device is disarmed, and a device that
is lost soon after it came back continues where its waits were.
"""
BACK_AT_ONCE = frozenset({LossCause.PROCESS_ENDED})
"""Causes of a loss that is over when it is told: the next process has been started."""
EXAMINE_EVERY_S = 5.0
"""Interval between examinations of a healthy device."""
STABLE_S = 10.0
"""A device that is lost again sooner than this has relapsed: it waits longer each time, and is not logged anew."""

CONTROL_THREAD_SUFFIX = " control"
"""End of the name of a device's thread, after the name of the device."""

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class DeviceLoss:
    """The reason and the kind of cause for which a device is lost."""

    reason: str
    cause: LossCause

    @property
    def message(self) -> CodedText:
        """The reason, coded by its fault if it has one, else by its cause."""
        if isinstance(self.reason, CodedText | Told):
            return CodedText(self.reason, findings_of(self.reason))
        return message(Code(f"device_{self.cause}"), reported=self.reason)

    def is_like(self, other: "DeviceLoss | None") -> bool:
        """True if both losses have one cause; losses of cause `OTHER` must have one reason as well."""
        return other is not None and (
            self == other if self.cause is LossCause.OTHER else self.cause is other.cause
        )


class DeviceKeeper:
    """Keeps a device armed from `start` to `close`; `tried` is set when the first attempt has succeeded or failed.

    `on_lost` is called for a loss that the device did not report itself, `on_back` for every return from a loss.
    """

    def __init__(
        self,
        name: str,
        device: Camera | LightGate,
        *,
        examine: Callable[[], CameraVitals] | None = None,
        on_lost: Callable[[str, LossCause], None] = lambda reason, cause: None,
        on_back: Callable[[], None] = lambda: None,
    ) -> None:
        self.name = name
        self.device = device
        self.state = DeviceState.CLOSED
        self.loss: DeviceLoss | None = None
        """The latest loss, None as long as there was none."""
        self.recoveries = 0
        self.vitals = CameraVitals()
        self.tried = asyncio.Event()
        self._disarmed = asyncio.Event()
        self._may_close = asyncio.Event()
        self._examine = examine
        self._on_lost = on_lost
        self._on_back = on_back
        self._lost_at_s = 0.0
        self._armed_at_s = 0.0
        self._n_losses = 0
        self._n_relapses = 0  # in a row
        self._wake = asyncio.Event()
        self._is_ending = False
        self._task: asyncio.Task[None] | None = None
        self._thread: ThreadPoolExecutor | None = None

    @property
    def last_error(self) -> CodedText | None:
        """Reason of the latest loss, None as long as there was none."""
        return None if self.loss is None else self.loss.message

    def start(self, sink: EventSink, tasks: asyncio.TaskGroup) -> None:
        """Keep the device armed until `close`, after which it may be started again."""
        self._is_ending = False
        for event in (self.tried, self._disarmed, self._may_close):
            event.clear()
        self._task = tasks.create_task(self._run(sink))

    async def disarm(self) -> None:
        """Disarm the device and keep it open until `close`; return when it is disarmed."""
        self._is_ending = True
        self._wake.set()
        await self._disarmed.wait()

    async def close(self) -> None:
        """Disarm and close the device; return when that is done."""
        self._is_ending = True
        self._may_close.set()
        self._wake.set()
        if self._task is not None:
            await asyncio.wait([self._task])

    def abandon(self) -> None:
        """Stop waiting for the device; its latest call may go on for a while on its thread."""
        if self._task is not None:
            self._task.cancel()

    async def call(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Call the device on its thread; allowed between `start` and `close`."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, function, *arguments)

    def mark_lost(self, reason: str, cause: LossCause = LossCause.OTHER) -> None:
        """Mark the device as lost; the loss is logged, later failed attempts only if they fail for another one."""
        loss = DeviceLoss(reason, cause)
        self._n_losses += 1
        now_s = time.monotonic()
        if self.state is DeviceState.ARMED:
            is_relapse = self.recoveries > 0 and now_s - self._armed_at_s < STABLE_S
            self._n_relapses = self._n_relapses + 1 if is_relapse else 0
        is_known = self._n_relapses > 0 and loss.is_like(self.loss)
        if self.state is not DeviceState.LOST:
            level = logging.DEBUG if is_known else logging.WARNING
            log.log(level, "device lost: %s device=%s", reason, self.name)
            self._lost_at_s = now_s
        elif not loss.is_like(self.loss):
            log.info("device still lost: %s device=%s", reason, self.name)
        self.state, self.loss = DeviceState.LOST, loss
        self._wake.set()

    def examine_now(self) -> None:
        """Examine the device without waiting for its next turn."""
        self._wake.set()

    async def _run(self, sink: EventSink) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix=self.name + CONTROL_THREAD_SUFFIX)
        failures = 0
        try:
            while not self._is_ending:
                n_losses = self._n_losses
                try:
                    await self.call(self.device.open)
                    await self.call(self.device.arm, sink)
                except DeviceError as err:
                    failures += 1
                    self.mark_lost(err.problem if err.device == self.name else err.told, err.cause)
                else:
                    if self._n_losses == n_losses:  # not lost again while it was being armed
                        self._mark_armed()
                        await self._examine_until_lost()
                    failures = self._n_relapses
                self.tried.set()
                if self.state is DeviceState.LOST:
                    await self.call(self.device.close)
                    self._wake.clear()  # set by the loss itself
                    is_there_again = failures == 0 and self.loss and self.loss.cause in BACK_AT_ONCE
                    if not self._is_ending and not is_there_again:
                        await self._wait_for_wake(BACK_OFF_S[min(failures, len(BACK_OFF_S) - 1)])
            if self.state is DeviceState.ARMED:
                await self.call(self.device.disarm)
            self._disarmed.set()
            await self._may_close.wait()
            await self.call(self.device.close)
            self.state = DeviceState.CLOSED
        finally:
            self._thread.shutdown(wait=False)
            self.tried.set()  # releases all waiting tasks
            self._disarmed.set()

    def _mark_armed(self) -> None:
        self._armed_at_s = time.monotonic()
        if self.state is DeviceState.LOST:
            self.recoveries += 1
            level = logging.DEBUG if self._n_relapses else logging.INFO
            log.log(
                level, "device back device=%s after_s=%.1f", self.name, self._armed_at_s - self._lost_at_s
            )
            self._on_back()
        self.state = DeviceState.ARMED
        self.tried.set()

    async def _examine_until_lost(self) -> None:
        """Examine the device again and again; return when it is lost or to be disarmed."""
        while self.state is DeviceState.ARMED and not self._is_ending:
            try:
                if self._examine is not None:
                    previous, self.vitals = self.vitals, await self.call(self._examine)
                    if self.vitals.remarks != previous.remarks:
                        for remark in self.vitals.remarks:
                            log.info("%s device=%s", remark, self.name)
            except DeviceError as err:
                self._on_lost(err.problem, err.cause)
                self.mark_lost(err.problem, err.cause)
                return
            await self._wait_for_wake(EXAMINE_EVERY_S)

    async def _wait_for_wake(self, timeout_s: float) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._wake.wait()
        self._wake.clear()
