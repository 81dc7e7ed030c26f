"""The properties of a simulated camera."""

from dataclasses import dataclass

from drivers.gige_simulator.features import Dialect
from drivers.gige_simulator.personalities import OLD, PLAIN, Personality
from pipeline.frames import CameraId


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraDesign:
    """The properties of one simulated camera; `ValueError` for impossible ones."""

    id: CameraId
    address: str  # IPv4, such as 127.0.0.2
    serial: str
    user_name: str = ""
    dialect: Dialect = "sfnc"
    image_size_px: tuple[int, int] = (1280, 1024)
    clock_offset_ns: int = 0  # what its clock shows at power-on
    clock_drift_ppm: float = 0.0
    is_clock_master: bool = False  # of PTP, once it has listened; otherwise another is
    seed: int = 0  # of all random numbers
    link_bytes_s: int = 115_000_000  # of a GigE link
    mtu_bytes: int = 9000  # of the link: larger test packets do not get through
    can_resend: bool = True  # whether resends are announced as a capability
    has_zipped_xml: bool = False
    personality: Personality | None = None  # None: the simulator's own, in its dialect

    def __post_init__(self) -> None:
        for name, text in (("serial", self.serial), ("user_name", self.user_name)):
            if len(text.encode()) > 16:
                raise ValueError(f"camera {self.id}: {name} {text!r} is longer than 16 bytes")
        width, height = self.image_size_px
        if width % 4 or height % 2 or width < 16 or height < 2:
            raise ValueError(f"camera {self.id}: image {width} x {height} px is not a multiple of 4 x 2 px")

    @property
    def ways(self) -> Personality:
        """Return the personality, the simulator's own where none is given."""
        return self.personality or (OLD if self.dialect == "legacy" else PLAIN)

    @property
    def is_xml_zipped(self) -> bool:
        return self.has_zipped_xml or self.ways.has_zipped_xml
