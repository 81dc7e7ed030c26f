"""Write the features of an open camera, read them back and compare, in either vendor dialect.

Every read is a round trip on the wire, and takes 2.5 s to fail when the camera is gone.
"""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from drivers.cameras.aravis_library import aravis_errors
from drivers.cameras.genicam import DEFAULTS_OF_ABSENT, OTHER_NAMES, REMEDIES, WRITE_ONLY, Feature, Value
from drivers.errors import CameraUnavailableError, LossCause
from pipeline.frames import CameraId


@dataclass(frozen=True, slots=True, kw_only=True)
class AppliedFeature:
    """A feature as the camera held it after it was written."""

    name: str  # in the camera's dialect
    value: Value

    @property
    def is_selector(self) -> bool:
        """Whether it selects the instance of the features after it; it is no setting in itself."""
        return self.name.endswith("Selector")


class FeatureAccess:
    """Reads and writes features; every failure is a `CameraUnavailableError` that names the feature.

    `own` is always the name of a feature in the camera's dialect, `name` its SFNC name.
    """

    def __init__(self, aravis: Any, camera: CameraId, device: Any) -> None:
        self._aravis = aravis
        self._camera = camera
        self._device = device

    def own_name(self, name: str) -> str | None:
        """Return the camera's name of a feature, given its SFNC name; None when the camera does not have it."""
        with aravis_errors(self._camera, f"ask for {name}"):
            for own in (name, *OTHER_NAMES.get(name, ())):
                if self._device.is_feature_available(own):
                    return own
        return None

    def apply(self, features: Iterable[Feature]) -> list[AppliedFeature]:
        """Write features in order and read each back; returns what `verify` must find from now on."""
        applied = []
        # no comprehension: the closure in an error's traceback would keep the camera
        for name, wanted in features:
            if (feature := self._apply(name, wanted)) is not None:
                applied.append(feature)
        return applied

    def verify(self, applied: Iterable[AppliedFeature]) -> None:
        """Read all features back; raises `CameraUnavailableError` at the first whose value has changed."""
        for feature in applied:
            if feature.is_selector:
                self._write(feature.name, feature.value)
            elif (got := self.read(feature.name)) != feature.value:
                raise self._error(f"setting {feature.name} is {got}, should be {feature.value}")

    def read(self, own: str) -> Value:
        """Return the value of a feature."""
        device, kind = self._device, self._kind(own)
        with aravis_errors(self._camera, f"read {own}"):
            if kind is bool:
                return bool(device.get_boolean_feature_value(own))
            if kind is int:
                return int(device.get_integer_feature_value(own))
            if kind is float:
                return float(device.get_float_feature_value(own))
            return str(device.get_string_feature_value(own))

    def entries(self, own: str) -> list[str]:
        """Return the values of an enumeration that can be set now."""
        with aravis_errors(self._camera, f"ask for the entries of {own}"):
            return list(self._device.dup_available_enumeration_feature_values_as_strings(own))

    def bounds(self, own: str) -> tuple[float, float]:
        """Return the present range of a number."""
        with aravis_errors(self._camera, f"read the range of {own}"):
            if self._kind(own) is int:
                low, high = self._device.get_integer_feature_bounds(own)
            else:
                low, high = self._device.get_float_feature_bounds(own)
        return low, high

    def can_be(self, own: str, value: float) -> bool:
        """True when a number's present range has this value."""
        low, high = self.bounds(own)
        return low <= value <= high

    def execute(self, own: str) -> None:
        """Execute a command."""
        with aravis_errors(self._camera, f"execute {own}"):
            self._device.execute_command(own)

    def _write(self, own: str, value: Value, name: str = "") -> None:
        setters = {
            bool: self._device.set_boolean_feature_value,
            int: self._device.set_integer_feature_value,
            float: self._device.set_float_feature_value,
            str: self._device.set_string_feature_value,
        }
        try:
            with aravis_errors(self._camera, f"set {own} to {value}"):
                setters[type(value)](own, value)
        except CameraUnavailableError as err:
            problem = f"{err.problem}{self._range(own)}{_remedy(name)}"
            raise CameraUnavailableError(self._camera, problem, err.cause) from err

    def _apply(self, name: str, wanted: Value) -> AppliedFeature | None:
        """Write one feature and read it back; None for what cannot be read back, and for what the camera lacks."""
        own = self.own_name(name)
        if own is None:
            if (name, wanted) in DEFAULTS_OF_ABSENT:
                return None
            others = "".join(f" nor {other}" for other in OTHER_NAMES.get(name, ()))
            remedy = _remedy(name) or ": remove it from the camera's features"
            raise self._error(f"has no {name}{others}{remedy}")
        if isinstance(self._device.get_feature(own), self._aravis.GcCommand):
            self.execute(own)
            return None
        value = self._converted(own, wanted)
        if name in WRITE_ONLY:
            self._write(own, value, name)
            return None
        if not self._is_same(own, self.read(own), value):  # a feature may be fixed and not writable
            self._write(own, value, name)
        got = self.read(own)
        if not self._is_same(own, got, value):
            problem = f"has {own} at {got} after it was set to {value}{self._range(own)}{_remedy(name)}"
            raise self._error(problem)
        return AppliedFeature(name=own, value=got)

    def _kind(self, own: str) -> type[Value]:
        node = self._device.get_feature(own)
        if isinstance(node, self._aravis.GcBoolean):
            return bool
        if isinstance(node, self._aravis.GcFloat):
            return float
        is_number = isinstance(node, self._aravis.GcInteger)  # which enumerations are, too
        return int if is_number and not isinstance(node, self._aravis.GcEnumeration) else str

    def _converted(self, own: str, wanted: Value) -> Value:
        """Return the value in the type of the feature; raises where that would change its meaning."""
        kind = self._kind(own)
        if own == "GainRaw" and isinstance(wanted, float):
            if wanted != 0.0:
                raise self._error(
                    f"cannot set Gain to {wanted} dB: it has only GainRaw, in its own steps; set that instead of Gain"
                )
            return int(self._device.get_integer_feature_bounds(own)[0])
        if kind is float and type(wanted) is int:
            return float(wanted)
        if kind is int and isinstance(wanted, float) and wanted.is_integer():
            return int(wanted)
        if type(wanted) is not kind:
            raise self._error(f"wants {own} as {kind.__name__}, not {wanted!r}")
        return wanted

    def _is_same(self, own: str, got: Value, wanted: Value) -> bool:
        """True when two values are equal, floats within the camera's increment."""
        if not (isinstance(got, float) and isinstance(wanted, float)):
            return got == wanted
        increment = 0.0
        with suppress(CameraUnavailableError), aravis_errors(self._camera, "read an increment"):
            increment = self._device.get_float_feature_increment(own)  # raises where there is none
        return abs(got - wanted) <= max(increment, 1e-6 * abs(wanted))

    def _range(self, own: str) -> str:
        """Return the end of a message: what a number or an enumeration can be, empty where that is not told."""
        with suppress(CameraUnavailableError):
            if self._kind(own) in (int, float):
                low, high = self.bounds(own)
                return f": it can do {low:.12g} to {high:.12g}"
            if isinstance(self._device.get_feature(own), self._aravis.GcEnumeration):
                return f": it can be {', '.join(self.entries(own))}"
        return ""

    def _error(self, problem: str) -> CameraUnavailableError:
        return CameraUnavailableError(self._camera, problem, LossCause.WRONG_SETTINGS)


def _remedy(name: str) -> str:
    return f": {REMEDIES[name]}" if name in REMEDIES else ""
