"""`[plant]` of the configuration: texts, zone and address that can be printed, and a logo that is one."""

import re
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from service.base.language import Language
from service.lots.plant import MAX_LOGO_BYTES, PlantSettings, logo_of, zone_of
from service.reports.words import words

SVG = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 2 1"><rect width="2" height="1"/></svg>'


def png(width: int, height: int, kind: str = "PNG") -> bytes:
    file = BytesIO()
    Image.new("1", (width, height)).save(file, kind)
    return file.getvalue()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("plant", ""),
        ("plant", "x" * 121),
        ("line", "a\nb"),
        ("laboratory", "a\x00"),
        ("instrument_serial", "x" * 65),
        ("time_zone", "Mars/Olympus"),
        ("time_zone", "../../etc/passwd"),
        ("time_zone", ""),
        ("base_url", "stonefall.plant"),
        ("base_url", "javascript:alert(1)"),
        ("base_url", "http://user:secret@stonefall"),
        ("base_url", "http://stonefall/?a=b"),
        ("base_url", "http://stonefall:port"),
    ],
)
def test_what_cannot_be_printed_is_refused_by_name(field: str, value: str) -> None:
    given: dict[str, Any] = {field: value}
    with pytest.raises(ValueError, match=f"^{field} "):
        PlantSettings(**given)


def test_a_logo_is_a_png_or_svg(tmp_path: Path) -> None:
    path = tmp_path / "logo"
    for content in (SVG.encode(), png(30, 20)):
        path.write_bytes(content)
        assert logo_of(path).startswith("<svg")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"x" * (MAX_LOGO_BYTES + 1), "has more than 500000 bytes"),
        (png(4001, 1000), "has more than 4 megapixels"),
        (png(30, 20)[:40], "is"),
        (png(30, 20, "BMP"), "is no PNG, and no SVG in UTF-8"),
        (b"", "is no PNG or SVG"),
        (b"<html/>", "that can be drawn"),
        (SVG[:60].encode(), "is no PNG or SVG"),
        (None, "No such file"),
    ],
)
def test_what_is_no_logo_is_refused_with_its_file(tmp_path: Path, content: bytes | None, reason: str) -> None:
    path = tmp_path / "logo.png"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=f"^{re.escape(str(path))}: .*{reason}"):
        logo_of(path)


@pytest.mark.parametrize(
    ("zone", "utc", "said"),
    [
        ("Europe/Berlin", "2026-11-20T13:03:00Z", "2026-11-20 14:03:00 CET (13:03 UTC)"),
        ("Europe/Berlin", "2026-07-20T13:03:00Z", "2026-07-20 15:03:00 CEST (13:03 UTC)"),
        ("Europe/Berlin", "2026-11-20T23:30:00Z", "2026-11-21 00:30:00 CET (2026-11-20 23:30 UTC)"),
        ("Europe/Berlin", "2026-10-25T00:30:00Z", "2026-10-25 02:30:00 CEST (00:30 UTC)"),
        ("Europe/Berlin", "2026-10-25T01:30:00Z", "2026-10-25 02:30:00 CET (01:30 UTC)"),
        ("UTC", "2026-11-20T13:03:00Z", "2026-11-20 13:03:00 UTC"),
        ("Asia/Kolkata", "2026-11-20T13:03:00Z", "2026-11-20 18:33:00 IST (13:03 UTC)"),
        ("Europe/Berlin", "soon", "soon"),
    ],
)
def test_a_time_is_local_with_utc_beside_it(zone: str, utc: str, said: str) -> None:
    assert words(Language.ENGLISH, zone_of(zone)).time(utc) == said


def test_an_address_leads_to_the_instrument() -> None:
    assert PlantSettings(base_url="http://h:1/x/").address("/lots/a?b=c") == "http://h:1/x/lots/a?b=c"
    assert PlantSettings().address("/lots/a") is None
