"""The ways of vendors: how GigE cameras name things, what they lack, and what their viewers leave on.

As public node maps, manuals and bug reports describe them; no camera was at hand. Sources are beside each.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.gige_simulator.features import Dialect

Setting = int | float | str


@dataclass(frozen=True, slots=True, kw_only=True)
class Personality:
    """Differences of a vendor's cameras from those of others; features by their SFNC names."""

    resembles: str  # whose cameras; they say so themselves, but as vendor they name this simulator
    model: str = "SF-1280"
    dialect: Dialect = "sfnc"
    selectors: tuple[str, ...] = ("FrameStart", "FrameBurstStart")  # entries of TriggerSelector
    lines: tuple[str, ...] = ("Line1", "Line2", "Line3")  # entries of LineSelector, the trigger's first
    inputs: Mapping[str, str] = field(default_factory=dict)
    """Line of each wired entry of TriggerSource; empty: all lines, under their own names."""
    action: str = "Action1"  # entry of TriggerSource
    other_sources: tuple[str, ...] = ()  # entries that nothing here drives
    pixel_formats: tuple[str, ...] = ("Mono8",)
    lacks: frozenset[str] = frozenset()
    fixed: frozenset[str] = frozenset()  # features that cannot be written
    names: Mapping[str, str] = field(default_factory=dict)  # the vendor's own name of a feature
    binning_engines: tuple[str, ...] = ()  # entries of BinningSelector, each with a binning of its own
    exposure_modes_us: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Range of the exposure time in each mode, if there are several."""
    max_delay_us: float = 1_000_000.0
    max_packet_bytes: int = 9000
    chunk_payload: int = 0x4001  # payload type in chunk mode
    has_extended_ids: bool = True  # block ids of 64 bits can be switched on
    has_zipped_xml: bool = False
    encoding: str = "utf-8"  # of its texts
    left_on: Mapping[str, Setting] = field(default_factory=dict)  # by the program that had it before

    @property
    def sources(self) -> Mapping[str, str]:
        """Return the line of each wired entry of TriggerSource."""
        return self.inputs or {line: line for line in self.lines}


_LEFT: Mapping[str, Setting] = {
    "ChunkModeActive": 1,
    "ReverseX": 1,
    "BinningHorizontal": 2,
    "BinningVertical": 2,
    "TestPattern": "GreyHorizontalRamp",
}

PLAIN = Personality(resembles="")
"""The simulator's own, in the names of the SFNC."""
OLD = Personality(resembles="", dialect="legacy", selectors=("FrameStart", "AcquisitionStart"))
"""The same in the names from before SFNC 2."""

BASLER = Personality(
    resembles="Basler",
    model="acA1300-60gm",
    dialect="legacy",
    # pypylon parameter classes: AcquisitionStart, FrameStart; Line1 in, Out1
    selectors=("AcquisitionStart", "FrameStart"),
    lines=("Line1", "Out1"),
    inputs={"Line1": "Line1"},
    other_sources=("Timer1Active", "Counter1End"),  # pypylon 526
    pixel_formats=("Mono8", "Mono12", "Mono12Packed"),
    chunk_payload=0x0004,  # GigE Vision 1.x, as aravis 753 has it of another vendor
    has_extended_ids=False,
    names={"TestPattern": "TestImageSelector", "BlackLevel": "BlackLevelRaw"},
    left_on={
        **_LEFT,
        "GevHeartbeatTimeout": 300_000,  # pylon under a debugger; pypylon 812
        "AcquisitionFrameRateEnable": 1,  # limits triggers: gst-plugin-pylon 147
        "AcquisitionFrameRate": 0.5,
    },
)
FLIR = Personality(
    resembles="FLIR",
    model="BFS-PGE-16S2M",
    selectors=("AcquisitionStart", "FrameStart", "FrameBurstStart"),
    lines=("Line0", "Line1", "Line2", "Line3"),  # camera_aravis 13: Line0
    inputs={"Line0": "Line0", "Line2": "Line2", "Line3": "Line3"},
    action="Action0",
    other_sources=("Counter0Start", "Counter0End", "LogicBlock0"),
    pixel_formats=("Mono8", "Mono10Packed", "Mono12Packed", "Mono10p", "Mono12p", "Mono16"),
    chunk_payload=0x0005,  # aravis 189
    max_delay_us=65_520.0,
    binning_engines=("Sensor", "ISP"),
    left_on={**_LEFT, "GammaEnable": 1, "Gamma": 0.8, "SequencerMode": "On", "BlackLevel": 5.0},
)
HIKROBOT = Personality(
    resembles="Hikrobot",
    model="MV-CA013-A0GM",
    selectors=("FrameBurstStart",),  # aravis 589
    lines=("Line0", "Line1", "Line2"),
    inputs={"Line0": "Line0", "Line2": "Line2"},
    other_sources=("Counter0",),
    pixel_formats=("Mono8", "Mono10", "Mono10Packed", "Mono12", "Mono12Packed"),
    exposure_modes_us={"Standard": (15.0, 1_000_000.0), "UltraShort": (1.0, 14.0)},  # aravis 398
    max_packet_bytes=8164,
    has_extended_ids=False,
    lacks=frozenset({"DeviceIndicatorMode", "SequencerMode"}),
    encoding="latin-1",
    left_on={
        "AcquisitionBurstFrameCount": 3,
        "ExposureTimeMode": "UltraShort",
        "ReverseX": 1,
        "DecimationHorizontal": 2,
        "BlackLevel": 10.0,
    },
)
DAHENG = Personality(
    resembles="Daheng",
    model="MER-131-75GM",
    lines=("Line0", "Line1", "Line2", "Line3"),
    inputs={"Line0": "Line0", "Line2": "Line2", "Line3": "Line3"},
    pixel_formats=("Mono8", "Mono10"),
    has_extended_ids=False,
    lacks=frozenset({"LineDebouncerTime", "DeviceIndicatorMode", "SequencerMode", "ExposureMode"}),
    encoding="gbk",
    left_on={"LUTEnable": 1, "ReverseY": 1, "DecimationVertical": 2, "OffsetX": 8, "OffsetY": 4},
)
JAI = Personality(
    resembles="JAI",
    model="GO-5000M-PGE",
    selectors=("AcquisitionStart", "AcquisitionEnd", "FrameStart"),
    lines=("Line5", "Line1", "Line2"),
    inputs={"Line5": "Line5"},  # the optical input
    other_sources=("PulseGenerator0", "UserOutput0", "NAND0Out1"),
    pixel_formats=("Mono8", "Mono10", "Mono10Packed"),
    lacks=frozenset({"LUTEnable", "GammaEnable", "DeviceIndicatorMode"}),  # LUTMode: rc_genicam_camera 4
    left_on={"ExposureMode": "TriggerWidth", "LUTMode": "Gamma", "Gamma": 0.45, "ChunkModeActive": 1},
)
IMAGING_SOURCE = Personality(
    resembles="The Imaging Source",
    model="DMK 33GX273",
    selectors=("FrameStart", "ExposureActive"),  # aravis 460, ic4-examples 9
    lines=("Line1", "Line2"),
    inputs={"Hardware": "Line1"},  # harvesters 233, 117
    other_sources=("Any",),  # IC3.5 samples 85
    pixel_formats=("Mono16", "Mono12p"),
    lacks=frozenset({"ExposureMode", "TriggerActivation", "SequencerMode", "LUTEnable"}),  # camera_aravis2 60
    has_zipped_xml=True,
    left_on={**_LEFT, "ReverseY": 1},
)
LUCID = Personality(
    resembles="Lucid",
    model="PHX016S-M",
    selectors=("AcquisitionStart", "FrameStart", "FrameBurstStart"),
    lines=("Line0", "Line1", "Line2", "Line3"),
    action="Action0",  # aravis 1011
    pixel_formats=("Mono8", "Mono10Packed", "Mono12Packed", "Mono12p", "Mono16"),  # aravis 412
    lacks=frozenset({"SequencerMode"}),
    has_zipped_xml=True,
    left_on={**_LEFT, "GevGVSPExtendedIDMode": "On", "Gamma": 2.0, "GammaEnable": 1},
)

PERSONALITIES: Mapping[str, Personality] = {
    each.resembles: each for each in (BASLER, FLIR, HIKROBOT, DAHENG, JAI, IMAGING_SOURCE, LUCID)
}
"""The vendors' personalities, by vendor."""
