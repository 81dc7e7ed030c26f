"""The features of a simulated camera: one table in two dialects.

Names follow the Standard Features Naming Convention (SFNC); the legacy dialect is the same table with the names of
older cameras, integer registers behind its floats, and values clamped instead of refused. A personality changes names,
entries and ranges, and leaves features out.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from drivers.gige_simulator.features import CHUNKS, PIXEL_FORMATS, PTP_STATES, Feature
from drivers.gige_simulator.personalities import Personality

USER_OUTPUTS = ("UserOutput1", "UserOutput2")
"""Entries of `LineSource`: the line is as high as the `UserOutputValue` of that output says."""

EXPOSURE_LIMITS = ("ExposureTimeMin", "ExposureTimeMax")
"""Range of the exposure time in cameras with several modes of it."""
_AUTOMATIC = ("Off", "Once", "Continuous")
_SETS = ("Default", "UserSet1")


def feature_table(
    ways: Personality, image_size_px: tuple[int, int], *, throughput_bytes_s: int
) -> tuple[Feature, ...]:
    """Return the features of a camera with a sensor of `image_size_px` (W, H) on a link of `throughput_bytes_s`."""
    table = (
        *_device(throughput_bytes_s),
        *_image_format(ways, *image_size_px),
        *_analog(),
        *_acquisition(ways),
        *_lines_and_counters(ways),
        *_transport(ways),
    )
    if ways.dialect == "legacy":
        table = tuple(_as_legacy(feature) for feature in table if feature.key not in _LEGACY_LACKS)
    lacks = ways.lacks if ways.has_extended_ids else {*ways.lacks, "GevGVSPExtendedIDMode"}
    return tuple(
        replace(
            feature,
            name=ways.names.get(feature.key, feature.name),
            access="RO" if feature.key in ways.fixed else feature.access,
        )
        for feature in table
        if feature.key not in lacks
    )


def _device(throughput_bytes_s: int) -> tuple[Feature, ...]:
    integer, floating, command = _integer("DeviceControl"), _float("DeviceControl"), _command("DeviceControl")
    text = partial(Feature, category="DeviceControl", kind="string", access="RO")
    return (
        text(name="DeviceVendorName", address=0x48, length=32),
        text(name="DeviceModelName", address=0x68, length=32),
        text(name="DeviceVersion", address=0x88, length=32),
        text(name="DeviceManufacturerInfo", address=0xA8, length=48),
        text(name="DeviceSerialNumber", address=0xD8, length=16),
        text(name="DeviceUserID", address=0xE8, length=16, access="RW"),
        floating(name="DeviceTemperature", access="RO", unit="C", minimum=-50, maximum=150),
        _choice("DeviceIndicatorMode", "DeviceControl", ("Inactive", "Active", "ErrorStatus"), value=1),
        command(name="DeviceReset"),
        command(name="TimestampLatch"),
        integer(
            name="TimestampLatchValue", access="RO", address=0x948, length=8, maximum=2**63 - 1, unit="ns"
        ),
        integer(
            name="DeviceLinkThroughputLimit",
            value=throughput_bytes_s,
            minimum=100_000,
            maximum=throughput_bytes_s,
            unit="B/s",
        ),
        _choice("UserSetSelector", "UserSetControl", _SETS, is_kept=False),
        _choice("UserSetDefault", "UserSetControl", _SETS, is_kept=False),
        _command("UserSetControl")(name="UserSetLoad", is_locked=True),
        _command("UserSetControl")(name="UserSetSave", is_locked=True),
    )


def _image_format(ways: Personality, width: int, height: int) -> tuple[Feature, ...]:
    category = "ImageFormatControl"
    switch, reduced = _switch(category), _integer(category, is_locked=True, value=1, minimum=1, maximum=4)
    engine = "BinningSelector" if ways.binning_engines else None
    formats = {name: PIXEL_FORMATS[name] for name in ways.pixel_formats}
    integer, extent = _integer(category), _integer(category, is_locked=True, maximum=max(width, height))
    return (
        integer(name="SensorWidth", access="RO", value=width, maximum=width),
        integer(name="SensorHeight", access="RO", value=height, maximum=height),
        *([_choice(engine, category, ways.binning_engines)] if engine else []),
        reduced(name="BinningHorizontal", selector=engine),
        reduced(name="BinningVertical", selector=engine),
        reduced(name="DecimationHorizontal"),
        reduced(name="DecimationVertical"),
        integer(name="WidthMax", access="RO", value=width, maximum=width),
        integer(name="HeightMax", access="RO", value=height, maximum=height),
        extent(name="Width", value=width, minimum=16, increment=4, limit=("WidthMax", "OffsetX")),
        extent(name="Height", value=height, minimum=2, increment=2, limit=("HeightMax", "OffsetY")),
        extent(name="OffsetX", increment=4, limit=("WidthMax", "Width")),
        extent(name="OffsetY", increment=2, limit=("HeightMax", "Height")),
        switch(name="ReverseX", is_locked=True),
        switch(name="ReverseY", is_locked=True),
        _choice("TestPattern", category, ("Off", "GreyHorizontalRamp")),
        _choice("PixelFormat", category, formats, value=formats[ways.pixel_formats[0]], is_locked=True),
        integer(name="PayloadSize", access="RO"),
    )


def _analog() -> tuple[Feature, ...]:
    category = "AnalogControl"
    floating, switch = _float(category), _switch(category)
    return (
        floating(name="Gain", maximum=24.0, unit="dB"),
        _choice("GainAuto", category, _AUTOMATIC),
        floating(name="BlackLevel", maximum=64.0),
        switch(name="GammaEnable"),
        floating(name="Gamma", value=1.0, minimum=0.25, maximum=4.0),
        switch(name="LUTEnable"),
        _choice("LUTMode", category, ("Off", "Gamma", "LUT")),
    )


def _acquisition(ways: Personality) -> tuple[Feature, ...]:
    category = "AcquisitionControl"
    floating, command, switch = _float(category), _command(category), _switch(category)
    integer, modes_us = _integer(category), ways.exposure_modes_us
    limits = [floating(name=name, access="RO", maximum=1_000_000.0, unit="us") for name in EXPOSURE_LIMITS]
    sources = (*ways.sources, "Software", ways.action, *ways.other_sources)
    of_trigger: dict[str, Any] = {"category": category, "selector": "TriggerSelector"}
    return (
        _choice("AcquisitionMode", category, ("Continuous", "SingleFrame"), is_locked=True),
        command(name="AcquisitionStart"),
        command(name="AcquisitionStop"),
        switch(name="AcquisitionStatus", access="RO"),
        floating(name="AcquisitionFrameRate", value=10.0, minimum=0.1, maximum=100.0, unit="Hz"),
        switch(name="AcquisitionFrameRateEnable"),
        _choice("SequencerMode", category, ("Off", "On")),
        integer(name="AcquisitionBurstFrameCount", value=1, minimum=1, maximum=255),
        _choice("TriggerSelector", category, ways.selectors),
        _choice("TriggerMode", **of_trigger, entries=("Off", "On")),
        _choice("TriggerSource", **of_trigger, entries=sources),
        _choice("TriggerActivation", **of_trigger, entries=("RisingEdge", "FallingEdge", "AnyEdge")),
        floating(name="TriggerDelay", selector="TriggerSelector", maximum=ways.max_delay_us, unit="us"),
        command(name="TriggerSoftware", selector="TriggerSelector"),
        _choice("ExposureMode", category, ("Timed", "TriggerWidth")),
        *((_choice("ExposureTimeMode", category, tuple(modes_us)), *limits) if modes_us else ()),
        floating(
            name="ExposureTime",
            value=1000.0,
            minimum=10.0,
            maximum=1_000_000.0,
            unit="us",
            bounds=EXPOSURE_LIMITS if modes_us else None,
        ),
        _choice("ExposureAuto", category, _AUTOMATIC),
    )


def _lines_and_counters(ways: Personality) -> tuple[Feature, ...]:
    lines, counters, actions = "DigitalIOControl", "CounterAndTimerControl", _integer("ActionControl")
    events = ("Off", "FrameTrigger", "FrameTriggerMissed", "ExposureStart")
    of_line: dict[str, Any] = {"category": lines, "selector": "LineSelector"}
    of_counter: dict[str, Any] = {"category": counters, "selector": "CounterSelector"}
    return (
        _choice("LineSelector", lines, ways.lines),
        _choice("LineMode", **of_line, entries=("Input", "Output")),
        _choice("LineSource", **of_line, entries=("Off", "ExposureActive", *USER_OUTPUTS)),
        _switch(**of_line)(name="LineInverter"),
        _switch(**of_line)(name="LineStatus", access="RO"),
        _float(**of_line)(name="LineDebouncerTime", maximum=20_000.0, unit="us"),
        _choice("UserOutputSelector", lines, USER_OUTPUTS),
        _switch(lines)(name="UserOutputValue", selector="UserOutputSelector"),
        _choice("CounterSelector", counters, ("Counter1", "Counter2")),
        _choice("CounterEventSource", **of_counter, entries=events, value=events.index("FrameTrigger")),
        _integer(**of_counter)(name="CounterValue", access="RO"),
        _command(**of_counter)(name="CounterReset"),
        actions(name="ActionDeviceKey", address=0x90C),
        actions(name="ActionGroupKey", address=0x9800),
        actions(name="ActionGroupMask", address=0x9804),
    )


def _transport(ways: Personality) -> tuple[Feature, ...]:
    category, chunks = "TransportLayerControl", "ChunkDataControl"
    integer, switch = _integer(category), _switch(category)
    return (
        _switch(chunks)(name="ChunkModeActive", is_locked=True),
        _choice("ChunkSelector", chunks, tuple(CHUNKS)),
        _switch(chunks)(name="ChunkEnable", selector="ChunkSelector", value=1, is_locked=True),
        integer(
            name="GevSCPSPacketSize",
            address=0xD04,
            bits=(16, 31),
            value=1500,
            minimum=220,
            maximum=ways.max_packet_bytes,
            increment=4,
            unit="B",
            is_locked=True,
        ),
        switch(name="GevSCPSDoNotFragment", address=0xD04, bits=(1, 1)),
        switch(name="GevSCPSFireTestPacket", address=0xD04, bits=(0, 0)),
        integer(name="GevSCPD", address=0xD08, maximum=100_000_000, unit="ns"),
        integer(
            name="GevHeartbeatTimeout",
            address=0x938,
            value=3000,
            minimum=500,
            maximum=3_600_000,
            unit="ms",
            is_kept=False,
        ),
        _choice("GevGVSPExtendedIDMode", category, ("Off", "On"), address=0x960, bits=(1, 1), is_locked=True),
        switch(name="PtpEnable"),
        _choice("PtpStatus", category, PTP_STATES, access="RO"),
        integer(
            name="PtpOffsetFromMaster",
            access="RO",
            length=8,
            minimum=-(2**63),
            maximum=2**63 - 1,
            unit="ns",
        ),
        _command(category)(name="PtpDataSetLatch"),
        integer(name="TLParamsLocked", maximum=1, is_kept=False),
    )


def _integer(category: str, **settings: Any) -> partial[Feature]:
    return partial(Feature, category=category, kind="integer", **settings)


def _float(category: str, **settings: Any) -> partial[Feature]:
    return partial(Feature, category=category, kind="float", **settings)


def _switch(category: str, **settings: Any) -> partial[Feature]:
    return partial(Feature, category=category, kind="boolean", **settings)


def _command(category: str, **settings: Any) -> partial[Feature]:
    return partial(Feature, category=category, kind="command", access="WO", **settings)


def _choice(
    name: str, category: str, entries: tuple[str, ...] | Mapping[str, int], **settings: Any
) -> Feature:
    """Return an enumeration; entries without numbers are counted from 0."""
    if isinstance(entries, tuple):
        entries = {entry: value for value, entry in enumerate(entries)}
    return Feature(name=name, category=category, kind="enumeration", entries=entries, **settings)


_LEGACY_NAMES = {
    "AcquisitionBurstFrameCount": "AcquisitionFrameCount",
    "DeviceSerialNumber": "DeviceID",
    "TimestampLatch": "GevTimestampControlLatch",
    "TimestampLatchValue": "GevTimestampValue",
    "AcquisitionFrameRate": "AcquisitionFrameRateAbs",
    "TriggerDelay": "TriggerDelayAbs",
    "ExposureTime": "ExposureTimeAbs",
    "Gain": "GainRaw",
    "LineDebouncerTime": "LineDebouncerTimeAbs",
    "PtpEnable": "GevIEEE1588",
    "PtpStatus": "GevIEEE1588Status",
    "PtpOffsetFromMaster": "GevIEEE1588OffsetFromMaster",
    "PtpDataSetLatch": "GevIEEE1588DataSetLatch",
}

_LEGACY_LACKS = frozenset({"DeviceIndicatorMode", "SequencerMode", "LUTMode"})
"""What cameras had not yet: these are found by what their output line lights."""

_LEGACY_STEPS = {
    "AcquisitionFrameRate": 0.01,
    "TriggerDelay": 1.0,
    "ExposureTime": 1.0,
    "LineDebouncerTime": 1.0,
    "DeviceTemperature": 0.1,
}
"""Floats that the legacy dialect keeps in an integer register, and the value of one count."""

GAIN_STEP_DB = 0.1
"""Value of one count of the legacy `GainRaw`."""


def _as_legacy(feature: Feature) -> Feature:
    renamed = replace(feature, name=_LEGACY_NAMES.get(feature.key, feature.name))
    if feature.key in _LEGACY_STEPS:
        return replace(renamed, kind="scaled", length=4, scale=_LEGACY_STEPS[feature.key])
    if feature.key == "Gain":
        return replace(renamed, kind="integer", length=4, scale=GAIN_STEP_DB, unit="")
    return renamed
