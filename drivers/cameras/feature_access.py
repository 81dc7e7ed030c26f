"""Writes the features of an open camera, reads them back and compares, whatever dialect it speaks.

Every read is a round trip on the wire, and takes 2.5 s to fail when the camera is gone.
"""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from drivers.cameras.aravis_library import explained
from drivers.cameras.genicam import OTHER_NAMES, UNNEEDED, WRITE_ONLY, Feature, Value
from drivers.errors import CameraUnavailableError, LossCause
from pipeline.frames import CameraId


@dataclass(frozen=True, slots=True, kw_only=True)
class Applied:
    """A feature as the camera holds it now."""

    name: str  # in the camera's own dialect
    value: Value

    @property
    def is_selector(self) -> bool:
        """It says what the features after it belong to; not a setting in itself."""
        return self.name.endswith("Selector")


class FeatureAccess:
    """Reads and writes; every failure is a `CameraUnavailableError` that names the feature."""

    def __init__(self, aravis: Any, camera: CameraId, device: Any) -> None:
        self._aravis = aravis
        self._camera = camera
        self._device = device

    def own_name(self, name: str) -> str | None:
        """What this camera calls the feature with that SFNC name; nothing when it has none."""
        with explained(self._camera, f"ask for {name}"):
            for own in (name, *OTHER_NAMES.get(name, ())):
                if self._device.is_feature_available(own):
                    return own
        return None

    def apply(self, features: Iterable[Feature]) -> list[Applied]:
        """Write in order, read each back; returns what `verify` is to find from now on."""
        applied = []
        for (
            name,
            wanted,
        ) in features:  # no comprehension: its closure would keep the camera as long as its error
            if (feature := self._apply(name, wanted)) is not None:
                applied.append(feature)
        return applied

    def verify(self, applied: Iterable[Applied]) -> None:
        """Read all features back; raises `CameraUnavailableError` at the first that is not as it was applied."""
        for feature in applied:
            if feature.is_selector:
                self._write(feature.name, feature.value)
            elif (got := self.read(feature.name)) != feature.value:
                raise self._error(f"setting {feature.name} is {got}, should be {feature.value}")

    def read(self, own: str) -> Value:
        """Value of what the camera itself calls so."""
        device, kind = self._device, self._kind(own)
        with explained(self._camera, f"read {own}"):
            if kind is bool:
                return bool(device.get_boolean_feature_value(own))
            if kind is int:
                return int(device.get_integer_feature_value(own))
            if kind is float:
                return float(device.get_float_feature_value(own))
            return str(device.get_string_feature_value(own))

    def execute(self, own: str) -> None:
        """Give the command the camera itself calls so."""
        with explained(self._camera, f"execute {own}"):
            self._device.execute_command(own)

    def _write(self, own: str, value: Value) -> None:
        setters = {
            bool: self._device.set_boolean_feature_value,
            int: self._device.set_integer_feature_value,
            float: self._device.set_float_feature_value,
            str: self._device.set_string_feature_value,
        }
        try:
            with explained(self._camera, f"set {own} to {value}"):
                setters[type(value)](own, value)
        except CameraUnavailableError as err:
            raise CameraUnavailableError(self._camera, f"{err.problem}{self._range(own)}", err.cause) from err

    def _apply(self, name: str, wanted: Value) -> Applied | None:
        """Nothing where nothing can be read back: a command, a key, what the camera need not be told."""
        own = self.own_name(name)
        if own is None:
            if (name, wanted) in UNNEEDED:
                return None
            others = "".join(f" nor {other}" for other in OTHER_NAMES.get(name, ()))
            raise self._error(f"has no {name}{others}: remove it from the camera's features")
        if isinstance(self._device.get_feature(own), self._aravis.GcCommand):
            self.execute(own)
            return None
        value = self._converted(own, wanted)
        if name in WRITE_ONLY:
            self._write(own, value)
            return None
        if not self._agree(own, self.read(own), value):  # as it is, it may be fixed and not writable
            self._write(own, value)
        got = self.read(own)
        if not self._agree(own, got, value):
            raise self._error(f"made {own} {got} of {value}{self._range(own)}")
        return Applied(name=own, value=got)

    def _kind(self, own: str) -> type[Value]:
        node = self._device.get_feature(own)
        if isinstance(node, self._aravis.GcBoolean):
            return bool
        if isinstance(node, self._aravis.GcFloat):
            return float
        is_number = isinstance(node, self._aravis.GcInteger)  # which enumerations are, too
        return int if is_number and not isinstance(node, self._aravis.GcEnumeration) else str

    def _converted(self, own: str, wanted: Value) -> Value:
        """As the camera wants it, without changing what it means."""
        kind = self._kind(own)
        if own == "GainRaw" and isinstance(wanted, float):
            if wanted != 0.0:
                raise self._error(
                    f"knows no {wanted} dB, only GainRaw in steps of its own: set that instead of Gain"
                )
            return int(self._device.get_integer_feature_bounds(own)[0])
        if kind is float and type(wanted) is int:
            return float(wanted)
        if kind is int and isinstance(wanted, float) and wanted.is_integer():
            return int(wanted)
        if type(wanted) is not kind:
            raise self._error(f"wants {own} as {kind.__name__}, not {wanted!r}")
        return wanted

    def _agree(self, own: str, got: Value, wanted: Value) -> bool:
        """The same, or for a float as near as the camera's increment allows."""
        if not (isinstance(got, float) and isinstance(wanted, float)):
            return got == wanted
        increment = 0.0
        with suppress(CameraUnavailableError), explained(self._camera, "read an increment"):
            increment = self._device.get_float_feature_increment(own)  # an error where there is none
        return abs(got - wanted) <= max(increment, 1e-6 * abs(wanted))

    def _range(self, own: str) -> str:
        """What the camera can do, for a number; silent where it does not say."""
        kind = self._kind(own)
        if kind not in (int, float):
            return ""
        with suppress(CameraUnavailableError), explained(self._camera, f"read the range of {own}"):
            if kind is int:
                low, high = self._device.get_integer_feature_bounds(own)
            else:
                low, high = self._device.get_float_feature_bounds(own)
            return f": it can do {low:.12g} to {high:.12g}"
        return ""

    def _error(self, problem: str) -> CameraUnavailableError:
        return CameraUnavailableError(self._camera, problem, LossCause.WRONG_SETTINGS)
