"""Lights of a camera: the lamp by which a person finds it, and the strobe that its output line fires.

The lamp is the status lamp, else what the strobe's line feeds.
"""

from collections.abc import Sequence

from drivers.cameras.feature_access import FeatureAccess
from drivers.cameras.genicam import Feature, strobe_features, strobe_line
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
        elif line is not None and (output := _user_output(features, line)) is not None:
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


def strobe_off(features: FeatureAccess, settings: Sequence[Feature]) -> list[Feature]:
    """Return the settings with the strobe's line as it is between two exposures, low also during them.

    The host sets the line if the camera lets it, which an inverter of the line then inverts as well; else it is off.
    """
    line = strobe_line(settings)
    if line is None:
        return list(settings)
    features.apply([("LineSelector", line), ("LineMode", "Output")])  # an input may have no sources
    output = _user_output(features, line)
    off: list[Feature] = [("LineSource", output or "Off")]
    if output is not None:
        off += [("UserOutputSelector", output), ("UserOutputValue", False)]
    return [
        each
        for setting in settings
        for each in (off if setting == ("LineSource", "ExposureActive") else [setting])
    ]


def give_strobe_back(features: FeatureAccess, settings: Sequence[Feature]) -> None:
    """Let the strobe's line follow the exposure again."""
    if (line := strobe_line(settings)) is not None:
        features.apply(strobe_features(line=line))


def _user_output(features: FeatureAccess, line: str) -> str | None:
    """Return the source by which the host sets a line, None if the camera has none."""
    if features.own_name("UserOutputValue") is None:
        return None
    features.apply([("LineSelector", line)])
    return next((entry for entry in features.entries("LineSource") if entry.startswith(USER_OUTPUT)), None)
