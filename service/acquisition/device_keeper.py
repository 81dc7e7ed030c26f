"""One device kept at work: opened and armed, examined, and brought back whenever it is lost.

Device calls block for seconds (a GigE control call takes 2.5 s to fail), so each device has a thread of
its own: a dead one makes nobody wait but itself.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from drivers.errors import DeviceError
from drivers.interfaces import Camera, CameraVitals, EventSink, LightGate
from service.status import DeviceState

log = logging.getLogger(__name__)

BACK_OFF_S = (0.5, 1.0, 2.0, 4.0, 5.0)
"""From one attempt to bring a device back to the next; the last one for ever."""
EXAMINE_S = 5.0
"""How often a healthy camera is asked how it is."""
STABLE_S = 10.0
"""Lost again sooner than this, a device was not really back: it is asked less and less often, and not logged anew."""

CONTROL_THREAD = " control"
"""How the name of a device's thread goes on after the device's."""

Answer = TypeVar("Answer")


class Keeper:
    """From `start` to `end` the device is kept; `settle` waits for the end of the first attempt.

    `on_lost` is told of a loss that the device did not report itself, `on_back` of every return from a loss.
    """

    def __init__(
        self,
        name: str,
        device: Camera | LightGate,
        *,
        examine: Callable[[], CameraVitals] | None = None,
        on_lost: Callable[[str], None] = lambda reason: None,
        on_back: Callable[[], None] = lambda: None,
    ) -> None:
        self.name = name
        self.device = device
        self.state = DeviceState.CLOSED
        self.last_error: str | None = None
        self.recoveries = 0
        self.vitals = CameraVitals()
        self._settled = asyncio.Event()
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

    def start(self, sink: EventSink, tasks: asyncio.TaskGroup) -> None:
        """Keep the device armed until `end`; it may be started again after that."""
        self._is_ending = False
        for event in (self._settled, self._disarmed, self._may_close):
            event.clear()
        self._task = tasks.create_task(self._keep(sink))

    async def settle(self) -> None:
        """Return when the device was tried once, whatever came of it."""
        await self._settled.wait()

    async def disarm(self) -> None:
        """Disarm and stay open until `end`; returns when that is done."""
        self._is_ending = True
        self._wake.set()
        await self._disarmed.wait()

    async def end(self) -> None:
        """Disarm and close; returns when that is done."""
        self._is_ending = True
        self._may_close.set()
        self._wake.set()
        if self._task is not None:
            await asyncio.wait([self._task])

    def abandon(self) -> None:
        """Wait for the device no longer; what it was last asked for may still be under way on its thread."""
        if self._task is not None:
            self._task.cancel()

    async def _keep(self, sink: EventSink) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix=self.name + CONTROL_THREAD)
        failures = 0
        try:
            while not self._is_ending:
                n_losses = self._n_losses
                try:
                    await self.call(self.device.open)
                    await self.call(self.device.arm, sink)
                except DeviceError as err:
                    failures += 1
                    self.lose(err.problem if err.device == self.name else str(err))
                else:
                    if self._n_losses == n_losses:  # not lost again while it was being armed
                        self._admit()
                        await self._look_after()
                    failures = self._n_relapses
                self._settled.set()
                if self.state is DeviceState.LOST:
                    await self.call(self.device.close)
                    self._wake.clear()  # of the loss itself
                    if not self._is_ending:
                        await self._sleep(BACK_OFF_S[min(failures, len(BACK_OFF_S) - 1)])
            if self.state is DeviceState.ARMED:
                await self.call(self.device.disarm)
            self._disarmed.set()
            await self._may_close.wait()
            await self.call(self.device.close)
            self.state = DeviceState.CLOSED
        finally:
            self._thread.shutdown(wait=False)
            self._settled.set()  # nobody shall wait any more
            self._disarmed.set()

    async def call(self, function: Callable[..., Answer], *arguments: object) -> Answer:
        """Call the device on its thread; only while it is kept."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, function, *arguments)

    def lose(self, reason: str) -> None:
        """Note that the device is lost; the loss is logged once, not every failed attempt to undo it."""
        self._n_losses += 1
        now_s = time.monotonic()
        if self.state is DeviceState.ARMED:
            is_relapse = self.recoveries > 0 and now_s - self._armed_at_s < STABLE_S
            self._n_relapses = self._n_relapses + 1 if is_relapse else 0
        is_known = self._n_relapses > 0 and reason == self.last_error
        if self.state is not DeviceState.LOST:
            level = logging.DEBUG if is_known else logging.WARNING
            log.log(level, "device lost: %s device=%s", reason, self.name)
            self._lost_at_s = now_s
        elif reason != self.last_error:
            log.info("device still lost: %s device=%s", reason, self.name)
        self.state, self.last_error = DeviceState.LOST, reason
        self._wake.set()

    def look(self) -> None:
        """Examine the device now: something about it is odd."""
        self._wake.set()

    def _admit(self) -> None:
        self._armed_at_s = time.monotonic()
        if self.state is DeviceState.LOST:
            self.recoveries += 1
            level = logging.DEBUG if self._n_relapses else logging.INFO
            log.log(
                level, "device back device=%s after_s=%.1f", self.name, self._armed_at_s - self._lost_at_s
            )
            self._on_back()
        self.state = DeviceState.ARMED
        self._settled.set()

    async def _look_after(self) -> None:
        """Return when the device is lost or no longer wanted."""
        while self.state is DeviceState.ARMED and not self._is_ending:
            if self._examine is not None:
                try:
                    self.vitals = await self.call(self._examine)
                except DeviceError as err:
                    self._on_lost(err.problem)
                    self.lose(err.problem)
                    return
            await self._sleep(EXAMINE_S)

    async def _sleep(self, seconds: float) -> None:
        """Wait, but not longer than until something happens."""
        try:
            async with asyncio.timeout(seconds):
                await self._wake.wait()
        except TimeoutError:
            pass
        self._wake.clear()
