"""The key of the instrument, and the check of a report that it signed."""

import asyncio
from typing import Annotated

from fastapi import APIRouter, Body

from service.reports.signatures import KeyDocument, ReportCheck, checked, key_document, known_fingerprints
from service.web.auth import READABLE
from service.web.context import Context

router = APIRouter(tags=["lots"], dependencies=READABLE)

PDF = "application/pdf"


@router.get("/instrument/key", response_model=KeyDocument)
async def instrument_key(context: Context) -> KeyDocument:
    """Get the public key of the instrument, by which its issued reports are checked anywhere."""
    return await context.store.read(key_document, context.store.dir)


@router.post("/reports/verify", response_model=ReportCheck)
async def verify_report(
    context: Context,
    content: Annotated[bytes, Body(media_type=PDF, description="The PDF as it was received")],
) -> ReportCheck:
    """Check a signed report: whether a byte was changed, and whether this instrument signed it."""
    known = await asyncio.to_thread(known_fingerprints, context.store.dir)
    return await asyncio.to_thread(checked, content, known)
