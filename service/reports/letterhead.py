"""Head and foot of a report: plant, instrument, logo and QR code; the signature of instrument and people."""

from base64 import b64encode
from io import BytesIO
from pathlib import Path

import typst
from PIL import Image

from drivers.files.bounded import read_bounded
from service.reports.document import Letterhead, Note, Section, Signatures, facts
from service.reports.report import ReportData
from service.reports.words import Words, abridged
from service.web.version import BASE

MAX_LOGO_BYTES = 500_000
MAX_LOGO_PX = 4_000_000
PNG_MAGIC = b"\x89PNG"
PNG = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">'
    '<image width="{width}" height="{height}" href="data:image/png;base64,{content}"/></svg>'
)


def logo_of(path: Path) -> str:
    """Return a logo as SVG; blocks. Raises `ValueError`, which names the file, if it is too large or no PNG or SVG."""
    try:
        content = read_bounded(path, MAX_LOGO_BYTES)
        logo = _of_png(content) if content.startswith(PNG_MAGIC) else content.decode()
        typst.compile(b"#image(bytes(sys.inputs.logo))", sys_inputs={"logo": logo}, ignore_system_fonts=True)
    except OSError as err:
        raise ValueError(f"{path}: {err.strerror or 'is a damaged picture'}") from err
    except (ValueError, SyntaxError, RuntimeError, Image.DecompressionBombError) as err:
        raise ValueError(f"{path}: is no PNG or SVG of at most {MAX_LOGO_PX // 10**6} megapixels") from err
    return logo


def _of_png(content: bytes) -> str:
    with Image.open(BytesIO(content), formats=("PNG",)) as image:
        if image.width * image.height > MAX_LOGO_PX:
            raise ValueError("too many pixels")
        sound = BytesIO()  # typst refuses some that Pillow reads
        image.save(sound, "PNG")
        encoded = b64encode(sound.getvalue()).decode()
        return PNG.format(width=image.width, height=image.height, content=encoded)


def letterhead(data: ReportData, say: Words) -> Letterhead:
    """Return the head of the first page."""
    plant, lot = data.plant, data.figures.lot
    lines = (say(f"plant.{name}", text=abridged(text)) for name, text in plant.texts.items() if text)
    path = f"{BASE}/lots/{lot.lot}/report?language={data.language}" if lot else ""
    address = plant.address(path) if lot else None
    return Letterhead(
        lines=tuple(lines),
        logo_svg=data.logo_svg,
        address=address,
        qr_svg=None if address is None else _qr(address),
    )


def _qr(address: str) -> str:
    import segno  # imported here: takes 0.1 s, and most reports have no address

    drawn = BytesIO()
    segno.make_qr(address, error="m").save(
        drawn, kind="svg", xmldecl=False, omitsize=True, border=2, light="#fff"
    )
    return drawn.getvalue().decode().strip()


def signature(data: ReportData, say: Words) -> Section:
    """Return the section of signatures: the instrument's, with all that it takes to check it, and lines for people."""
    names = Signatures((say("signature.tested_by"), say("signature.released_by")))
    if data.signer is None:
        return Section(say("signature.title"), (Note(say("signature.not_signed")), names))
    serial = data.plant.instrument_serial
    instrument = (
        say("signature.instrument") if serial is None else say("plant.instrument_serial", text=serial)
    )
    block = facts(say, "signature", signed=f"{instrument}, {say.time(data.created_at)}", key=data.signer)
    return Section(say("signature.title"), (block, Note(say("signature.check")), names))
