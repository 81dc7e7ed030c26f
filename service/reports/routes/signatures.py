"""The key of the instrument, and the check of a report that it signed."""

import asyncio
import re
from typing import Annotated

from fastapi import APIRouter
from pydantic import Base64Bytes, BeforeValidator, Field

from service.base.schema import request_body
from service.reports.signatures import (
    MAX_REPORT_BYTES,
    KeyDocument,
    ReportCheck,
    checked,
    key_document,
    known_fingerprints,
)
from service.web.auth import READABLE
from service.web.context import Context

router = APIRouter(tags=["lots"], dependencies=READABLE)

BASE64 = re.compile(r"[A-Za-z0-9+/\s]*(=\s*){0,2}")


def _of_the_alphabet(text: object) -> object:
    """Return a text in base64 as it is; raise `ValueError` for other characters, which decoding would drop."""
    if isinstance(text, str) and BASE64.fullmatch(text) is None:
        raise ValueError("must be base64 with + and / (RFC 4648, 4)")
    return text


@request_body
class SignedFile:
    """A report as it was received."""

    pdf: Annotated[
        Base64Bytes,
        BeforeValidator(_of_the_alphabet),
        Field(min_length=1, max_length=MAX_REPORT_BYTES, repr=False),
    ]
    """All bytes of the file, in base64; with a body of 1 MB (`[api] max_body_bytes`) up to 740 kB."""


@router.get("/instrument/key", response_model=KeyDocument)
async def instrument_key(context: Context) -> KeyDocument:
    """Get the public key of the instrument, by which its issued reports are checked anywhere."""
    return await context.store.read(key_document, context.store.dir)


@router.post("/reports/verify", response_model=ReportCheck)
async def verify_report(context: Context, file: SignedFile) -> ReportCheck:
    """Check a signed report: whether a byte was changed, and whether this instrument signed it."""
    known = await asyncio.to_thread(known_fingerprints, context.store.dir)
    return await asyncio.to_thread(checked, file.pdf, known)
