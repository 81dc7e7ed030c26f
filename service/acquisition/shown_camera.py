"""Show a person one camera of a disarmed rig: its lamp blinks for some seconds."""

import asyncio
import logging
from contextlib import suppress

from drivers.errors import CameraUnavailableError
from drivers.interfaces import Camera, CameraVitals

log = logging.getLogger(__name__)

BLINK_S = 0.5
"""Time between light and dark: one lamp that blinks is found among fifteen that shine."""


class ShownCamera:
    """Opens one camera at a time to blink its lamp, and always closes it when its time is over.

    For one caller at a time.
    """

    def __init__(self) -> None:
        self._enough = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    async def show(self, camera: Camera, seconds: float) -> CameraVitals:
        """Open a camera, let it blink from now on for some seconds, and return what it says about itself.

        Raises `CameraUnavailableError` if it does not answer, is another one, or has no lamp; it is closed then.
        """
        await self.end()
        self._enough.clear()
        told: asyncio.Future[CameraVitals] = asyncio.get_running_loop().create_future()
        self._task = asyncio.create_task(self._show(camera, seconds, told))
        return await asyncio.shield(told)

    async def end(self) -> None:
        """Return when no camera is open for this any more."""
        self._enough.set()
        if self._task is not None:
            await asyncio.wait([self._task])

    async def _show(self, camera: Camera, seconds: float, told: asyncio.Future[CameraVitals]) -> None:
        is_on = True
        try:
            await asyncio.to_thread(camera.open)
            vitals = await asyncio.to_thread(camera.examine)
            await asyncio.to_thread(camera.light, is_on=is_on)
            told.set_result(vitals)
            with suppress(TimeoutError):
                async with asyncio.timeout(seconds):
                    while not self._enough.is_set():
                        with suppress(TimeoutError):
                            await asyncio.wait_for(self._enough.wait(), BLINK_S)
                        is_on = not is_on
                        await asyncio.to_thread(camera.light, is_on=is_on)
        except CameraUnavailableError as err:
            if told.done():
                log.warning("a camera was lost while it blinked: %s", err)
            else:
                told.set_exception(err)
        finally:
            if not told.done():
                told.cancel()
            await asyncio.to_thread(camera.close)
