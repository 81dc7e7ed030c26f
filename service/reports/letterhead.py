"""Head and foot of a report: plant, instrument, logo and QR code; the signature of instrument and people."""

from service.base.qr import qr_svg
from service.lots.plant import PlantSettings
from service.reports.document import Letterhead, Note, Section, Signatures, facts
from service.reports.report import ReportData
from service.reports.words import Words, abridged
from service.web.version import BASE


def letterhead(plant: PlantSettings, logo_svg: str | None, path: str | None, say: Words) -> Letterhead:
    """Return the head of the first page; `path` is where the report is to be seen at the instrument."""
    lines = (say(f"plant.{name}", text=abridged(text)) for name, text in plant.texts.items() if text)
    address = plant.address(f"{BASE}{path}?language={say.language}") if path else None
    return Letterhead(
        lines=tuple(lines),
        logo_svg=logo_svg,
        address=address,
        qr_svg=None if address is None else qr_svg(address),
    )


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
