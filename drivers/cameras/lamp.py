"""The lamp by which a person finds a camera: its status lamp, else what its strobe's line feeds."""

from collections.abc import Sequence

from drivers.cameras.feature_access import FeatureAccess
from drivers.cameras.genicam import Feature, strobe_line
from drivers.errors import CameraUnavailableError
from pipeline.frames import CameraId

STATUS_LAMP = "DeviceIndicatorMode"
"""SFNC's switch of the status lamps; `Active` is as usual, and lit while the camera is well."""
USER_OUTPUT = "UserOutput"
"""Beginning of the entries of `LineSource` by which the host itself sets a line."""


class Lamp:
    """The lamp of an open camera that does not acquire; raises `CameraUnavailableError` if it has none.

    A line is lent to the host by `LineSource`, which opening a camera writes: a host that is killed meanwhile leaves
    nothing behind that would disturb the strobe.
    """

    def __init__(self, features: FeatureAccess, camera: CameraId, settings: Sequence[Feature]) -> None:
        self._features = features
        self._on: list[Feature]
        self._off: list[Feature]
        self._usual: list[Feature]
        line = strobe_line(settings)
        if (own := features.own_name(STATUS_LAMP)) is not None:
            self._on, self._off = [(STATUS_LAMP, "Active")], [(STATUS_LAMP, "Inactive")]
            self._usual = [(STATUS_LAMP, features.read(own))]
        elif line is not None and (output := self._user_output(line)) is not None:
            source: list[Feature] = [
                ("LineSelector", line),
                ("LineSource", output),
                ("UserOutputSelector", output),
            ]
            self._on, self._off = [*source, ("UserOutputValue", True)], [*source, ("UserOutputValue", False)]
            self._usual = [*self._off, ("LineSource", "ExposureActive")]
        else:
            problem = f"has no lamp to switch: neither {STATUS_LAMP} nor a strobe_line with {USER_OUTPUT}"
            raise CameraUnavailableError(camera, problem)

    def switch(self, *, is_on: bool) -> None:
        """Light it or make it dark."""
        self._features.apply(self._on if is_on else self._off)

    def give_back(self) -> None:
        """Let it show again what it usually shows."""
        self._features.apply(self._usual)

    def _user_output(self, line: str) -> str | None:
        """Return the source by which the host sets a line, None if the camera has none."""
        if self._features.own_name("UserOutputValue") is None:
            return None
        self._features.apply([("LineSelector", line)])
        return next(
            (entry for entry in self._features.entries("LineSource") if entry.startswith(USER_OUTPUT)), None
        )
