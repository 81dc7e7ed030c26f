"""`[plant]` of the configuration: what reports say of plant and instrument, with their logo and their zone of time."""

import re
from base64 import b64encode
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from urllib.parse import quote, urlsplit
from zoneinfo import ZoneInfo

import typst
from PIL import Image

from drivers.files.bounded import read_bounded
from service.base.addresses import is_host
from service.base.paths import ConfiguredPath

LONGEST = {"plant": 120, "line": 120, "laboratory": 120, "instrument_serial": 64, "base_url": 200}
"""Characters of a text."""
MAX_LOGO_BYTES = 500_000
MAX_LOGO_PX = 4_000_000
PNG_MAGIC = b"\x89PNG"
PNG = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">'
    '<image width="{width}" height="{height}" href="data:image/png;base64,{content}"/></svg>'
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantSettings:
    """Plant, line and instrument as reports name them; what is not given is on no report."""

    plant: str | None = None
    line: str | None = None
    instrument_serial: str | None = None
    laboratory: str | None = None  # that answers for the report
    logo: ConfiguredPath | None = None  # PNG or SVG
    time_zone: str | None = None  # IANA; None: the host's
    base_url: str | None = None  # by which those who get reports reach the instrument; None: no QR code

    def __post_init__(self) -> None:
        for name, longest in LONGEST.items():
            text = getattr(self, name)
            if text is not None and not (1 <= len(text) <= longest and text.isprintable()):
                raise ValueError(f"{name} must have 1 to {longest} printable characters")
        if self.time_zone is not None and zone_of(self.time_zone) is None:
            raise ValueError(f"time_zone is a name such as Europe/Berlin, not {self.time_zone!r}")
        if self.base_url is not None and not _is_address(self.base_url):
            raise ValueError(
                f"base_url is an address such as http://stonefall.plant:8080, not {self.base_url!r}"
            )

    @property
    def zone(self) -> ZoneInfo | None:
        """Zone of the times of a report; None: the host's."""
        return None if self.time_zone is None else zone_of(self.time_zone)

    @property
    def name(self) -> str:
        """Plant, line and instrument in the heads of pages; empty if none is given."""
        return ", ".join(each for each in (self.plant, self.line, self.instrument_serial) if each)

    @property
    def texts(self) -> dict[str, str | None]:
        """What a report says of the plant, by the names of the settings."""
        return {name: getattr(self, name) for name in ("plant", "line", "instrument_serial", "laboratory")}

    @property
    def rig(self) -> str | None:
        """Plant, line and instrument in one line; None where none is given."""
        return ", ".join(text for text in (self.plant, self.line, self.instrument_serial) if text) or None

    def address(self, path: str) -> str | None:
        """Return the address of a path at the instrument, None if people do not reach it."""
        return None if self.base_url is None else self.base_url.rstrip("/") + quote(path, safe="/?=&")


@cache
def zone_of(name: str) -> ZoneInfo | None:
    """Return a zone by its IANA name, None if the host does not know it."""
    try:
        return ZoneInfo(name)
    except (OSError, ValueError, KeyError):  # a folder of zones; no name of a file; not found
        return None


def _is_address(text: str) -> bool:
    """True for an address of HTTP without user, query and fragment."""
    try:
        parts = urlsplit(text)
        _ = parts.port
    except ValueError:
        return False
    is_plain = not re.search(r"[\s@?#]", text)
    return parts.scheme in ("http", "https") and is_host(parts.hostname or "") and is_plain


def logo_of(path: Path) -> str:
    """Return a logo as SVG; blocks. Raises `ValueError`, which names the file, if it is too large or no PNG or SVG."""
    try:
        content = read_bounded(path, MAX_LOGO_BYTES)
        logo = _of_png(content) if content.startswith(PNG_MAGIC) else content.decode()
        typst.compile(b"#image(bytes(sys.inputs.logo))", sys_inputs={"logo": logo}, ignore_system_fonts=True)
    except OSError as err:
        raise ValueError(f"{path}: {err.strerror or 'is a damaged picture'}") from err
    except Image.DecompressionBombError as err:
        raise ValueError(f"{path}: has more than {MAX_LOGO_PX // 10**6} megapixels") from err
    except UnicodeDecodeError as err:
        raise ValueError(f"{path}: is no PNG, and no SVG in UTF-8") from err
    except (ValueError, SyntaxError, RuntimeError) as err:
        raise ValueError(f"{path}: is no PNG or SVG that can be drawn") from err
    return logo


def _of_png(content: bytes) -> str:
    with Image.open(BytesIO(content), formats=("PNG",)) as image:
        if image.width * image.height > MAX_LOGO_PX:
            raise Image.DecompressionBombError
        sound = BytesIO()  # typst refuses some that Pillow reads
        image.save(sound, "PNG")
        encoded = b64encode(sound.getvalue()).decode()
        return PNG.format(width=image.width, height=image.height, content=encoded)
