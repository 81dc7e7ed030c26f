"""The stones of a lot as files: CSV for spreadsheets, Parquet for programs."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, BinaryIO

from fastapi import APIRouter, Query
from fastapi.responses import StreamingResponse

from service.base.csv_text import RFC_4180, STYLES, CsvStyle
from service.base.language import Language
from service.lots.lots import find_lot
from service.lots.routes.lots import LotName
from service.lots.stone_files import csv_piece, join_parquet, parquet_piece
from service.web.auth import READABLE
from service.web.context import ApiContext, Context
from service.web.problems import existing

router = APIRouter(prefix="/lots", tags=["lots"], dependencies=READABLE)

CSV, PARQUET = "text/csv", "application/vnd.apache.parquet"
SENT_BYTES = 1 << 18


@router.get("/{lot}/stones.csv", response_class=StreamingResponse, responses={200: {"content": {CSV: {}}}})
async def stones_csv(
    context: Context,
    lot: LotName,
    language: Annotated[
        Language | None,
        Query(
            description="Of the spreadsheet: `de` gives semicolons, decimal commas and a byte order mark; RFC 4180"
            " when absent"
        ),
    ] = None,
) -> StreamingResponse:
    """Download all stones of a lot as CSV: a line each, with all fields of its result.

    What is a list or a map is JSON. Of results that were removed the fields are there that lists and lots need.
    """
    existing(await context.store.read(find_lot, lot), "lot", lot)
    style = RFC_4180 if language is None else STYLES[language]
    first = await _csv_piece(context, lot, style, 0)
    return StreamingResponse(
        _csv_pieces(context, lot, style, first),
        media_type=f"{CSV}; charset=utf-8",
        headers=_named(lot, "csv"),
    )


async def _csv_pieces(
    context: ApiContext, lot: str, style: CsvStyle, piece: tuple[bytes, int | None]
) -> AsyncIterator[bytes]:
    content, last = piece
    yield content
    while last is not None:
        content, last = await _csv_piece(context, lot, style, last)
        yield content


async def _csv_piece(context: ApiContext, lot: str, style: CsvStyle, after: int) -> tuple[bytes, int | None]:
    return await context.read_beside(csv_piece, lot, after, style)


@router.get(
    "/{lot}/stones.parquet", response_class=StreamingResponse, responses={200: {"content": {PARQUET: {}}}}
)
async def stones_parquet(context: Context, lot: LotName) -> StreamingResponse:
    """Download all stones of a lot as Parquet: a row each, with all fields of its result, as `stones.csv` has them.

    The metadata of a column have its `unit` and `description`.
    """
    existing(await context.store.read(find_lot, lot), "lot", lot)
    file = await _parquet(context, lot)
    return StreamingResponse(_sent(file), media_type=PARQUET, headers=_named(lot, "parquet"))


async def _parquet(context: ApiContext, lot: str) -> BinaryIO:
    """Return the open file, which has no name any more: it is gone with its last reader."""
    with TemporaryDirectory(prefix="stonefall-stones-") as name:
        folder = Path(name)
        pieces: list[Path] = []
        last: int | None = 0
        while last is not None:
            pieces.append(folder / f"{len(pieces)}.parquet")
            last = await context.read_beside(parquet_piece, lot, last, pieces[-1])
        await context.reading.run(join_parquet, pieces, folder / "stones.parquet")
        return await asyncio.to_thread((folder / "stones.parquet").open, "rb")


def _sent(file: BinaryIO) -> Iterator[bytes]:
    with file:
        yield from iter(partial(file.read, SENT_BYTES), b"")


def _named(lot: str, ending: str) -> dict[str, str]:
    return {"Content-Disposition": f'attachment; filename="{lot}-stones.{ending}"'}
