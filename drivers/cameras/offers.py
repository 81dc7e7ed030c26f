"""Settings as a camera offers them: entries under other names, neutral values for what other programs left on."""

from collections.abc import Collection, Iterable, Iterator, Sequence

from drivers.cameras.feature_access import AppliedFeature, FeatureAccess
from drivers.cameras.genicam import (
    GEOMETRY,
    INPUTS,
    NEUTRAL,
    OTHER_NAMES,
    SELECTORS,
    SWITCHES,
    Feature,
    Value,
)
from drivers.cameras.pixel_formats import CONVERTED
from drivers.errors import CameraUnavailableError, DeviceFault, LossCause, Told, told

OTHER_ENTRIES: dict[Feature, tuple[str, ...]] = {
    ("PixelFormat", "Mono8"): tuple(CONVERTED),
    ("TriggerSelector", "FrameStart"): ("FrameBurstStart", "AcquisitionStart"),
    ("TriggerSource", "Action1"): ("Action0",),
}
"""Entries that do the same, in cameras without the usual one."""
ONE_A_BURST: Feature = ("AcquisitionBurstFrameCount", 1)


def put_back(
    features: FeatureAccess, configured: Iterable[Feature]
) -> tuple[list[AppliedFeature], list[Told]]:
    """Set everything neutral that is not configured; return what holds now, and a remark for each change.

    A configuration that loads a user set of the camera has all of its features configured. What cannot be written
    stays as it is, and is a remark too; what decides where the pixels look is an error then.
    """
    held: list[AppliedFeature] = []
    remarks: list[Told] = []
    for selection, own, (name, neutral) in _unset(features, {name for name, _ in configured}):
        held += features.apply(selection)
        before = features.read(own)
        try:
            held += features.apply([(name, _nearest(features, own, neutral))])
        except CameraUnavailableError as err:
            if err.cause not in (LossCause.WRONG_SETTINGS, LossCause.OTHER):
                raise
            if name in GEOMETRY:
                problem = f"{err.problem}; if {own} shall stay {before}, set it so in features"
                raise CameraUnavailableError(err.device, problem, err.cause) from err
            remarks.append(told(DeviceFault.FEATURE_STAYS, feature=own, value=str(before)))
            continue
        if (after := features.read(own)) != before:
            remarks.append(was_put_back(own, before, after))
    return held, remarks


def _unset(
    features: FeatureAccess, configured: Collection[str]
) -> Iterator[tuple[list[Feature], str, Feature]]:
    """Yield the neutral features that the camera has and the configuration does not set, by either of their names.

    With each comes what selects it, where the camera has several of it, and its name in the camera's dialect.
    """
    if "UserSetLoad" in configured:
        return
    for name, neutral in NEUTRAL:
        own = features.own_name(name)
        if own is None or not {name, *OTHER_NAMES.get(name, ())}.isdisjoint(configured):
            continue
        if any(features.own_name(switch) for switch in SWITCHES.get(name, ())):
            continue
        selector = features.own_name(SELECTORS[name]) if name in SELECTORS else None
        for entry in features.entries(selector) if selector else [""]:
            yield [(selector, entry)] if selector else [], own, (name, neutral)


def as_offered(features: FeatureAccess, wanted: Sequence[Feature], remarks: list[Told]) -> Iterator[Feature]:
    """Yield the features as this camera has them, each once those before it are written.

    Other entries are used for those that it lacks, each with a remark; a line that triggers becomes an input, and a
    mode of exposure is chosen that has the exposure time.
    """
    for name, value in wanted:
        own = features.own_name(name)
        used = value if own is None or not isinstance(value, str) else _entry(features, own, (name, value))
        if used != value:
            remarks.append(told(DeviceFault.ENTRY_INSTEAD, feature=name, wanted=str(value), used=str(used)))
        if name == "ExposureTime" and own is not None and isinstance(value, int | float):
            yield from _exposure_mode(features, own, value)
        if name == "TriggerSource":
            yield from _input_line(features, str(used), remarks)
        yield name, used
        if (name, value) == ("TriggerSelector", "FrameStart") and used != value:
            if used == "FrameBurstStart" and features.own_name(ONE_A_BURST[0]) is None:
                continue
            yield ONE_A_BURST


def _entry(features: FeatureAccess, own: str, wanted: Feature) -> str:
    """Return the entry of an enumeration to use: the wanted one, or one that does the same."""
    name, entry = wanted[0], str(wanted[1])
    others = OTHER_ENTRIES.get(wanted, ())
    is_wire = name == "TriggerSource" and entry.startswith(INPUTS)
    if not (others or is_wire):
        return entry
    offered = features.entries(own)
    if entry in offered:
        return entry
    if is_wire:
        wires = [each for each in offered if each.startswith(INPUTS)]
        return wires[0] if len(wires) == 1 else entry  # among several it is not known which one is wired
    return next((each for each in others if each in offered), entry)


def _exposure_mode(features: FeatureAccess, own: str, exposure_us: float) -> Iterator[Feature]:
    """Yield the mode in which the camera can expose so long, where it has several; none if it can now."""
    mode = features.own_name("ExposureTimeMode")
    if mode is None or features.can_be(own, exposure_us):
        return
    present = features.read(mode)
    for entry in features.entries(mode):
        features.apply([("ExposureTimeMode", entry)])
        if features.can_be(own, exposure_us):
            yield "ExposureTimeMode", entry
            return
    features.apply([("ExposureTimeMode", present)])


def _input_line(features: FeatureAccess, source: str, remarks: list[Told]) -> Iterator[Feature]:
    """Yield the features that make the line of a trigger source an input."""
    if features.own_name("LineSelector") is None or source not in features.entries("LineSelector"):
        return
    yield "LineSelector", source
    if features.own_name("LineMode") is not None:
        if (before := features.read("LineMode")) != "Input":
            remarks.append(was_put_back(f"LineMode of {source}", before, "Input"))
        yield "LineMode", "Input"


def was_put_back(feature: str, before: Value, after: Value) -> Told:
    """Return the remark on a setting that another program had left on."""
    return told(DeviceFault.FEATURE_PUT_BACK, feature=feature, before=str(before), after=str(after))


def _nearest(features: FeatureAccess, own: str, neutral: Value) -> Value:
    """Return the neutral value; of a level whose range begins above it, the least."""
    return max(features.bounds(own)[0], 0.0) if own.startswith("BlackLevel") else neutral
