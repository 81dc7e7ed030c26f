"""A camera that another process has the library of."""

from contextlib import suppress

from drivers.camera_process.messages import CameraSettings, Doing
from drivers.camera_process.process import CameraProcess
from drivers.errors import CameraUnavailableError
from drivers.interfaces import CameraVitals, EventSink
from drivers.outlet import Outlet
from pipeline.frames import CameraId


class RemoteCamera:
    """A camera whose library runs in another process: it is lost with that, and opened again in the next one."""

    def __init__(self, settings: CameraSettings, process: CameraProcess) -> None:
        self._settings = settings
        self._process = process
        self._outlet = Outlet()
        process.register(settings.id, self._outlet)

    @property
    def id(self) -> CameraId:
        return self._settings.id

    def open(self) -> None:
        self._process.call(self._settings, Doing.OPEN)

    def arm(self, sink: EventSink) -> None:
        self.disarm()
        self._outlet.plug(sink)
        try:
            self._process.call(self._settings, Doing.ARM)
        except CameraUnavailableError:
            self._outlet.unplug()
            raise

    def examine(self) -> CameraVitals:
        return self._process.call(self._settings, Doing.EXAMINE) or CameraVitals()

    def software_trigger(self) -> None:
        """Expose now, if `TriggerSource` is `Software`; raises `CameraUnavailableError`."""
        self._process.call(self._settings, Doing.SOFTWARE_TRIGGER)

    def light(self, *, is_on: bool) -> None:
        self._process.call(self._settings, Doing.LIGHT if is_on else Doing.DARKEN)

    def disarm(self) -> None:
        with suppress(CameraUnavailableError):  # without its process it delivers nothing
            self._process.call(self._settings, Doing.DISARM)
        self._outlet.unplug()

    def close(self) -> None:
        with suppress(CameraUnavailableError):
            self._process.call(self._settings, Doing.CLOSE)
        self._outlet.unplug()
