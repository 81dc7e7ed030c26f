"""All stones of a lot as CSV or Parquet, each with all fields of its result, made in pieces of bounded size."""

import sqlite3
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from pipeline.frames import rfc3339
from service.base.csv_text import CsvStyle, csv_text
from service.results.columns import Cell, ColumnKind, columns_of_stones
from service.store.reads import stones_after

STONES_OF_A_PIECE = 2000
"""Stones that are read at a time: a second of an idle core."""
COMPRESSION = "zstd"


def csv_piece(
    connection: sqlite3.Connection, lot: str, after: int, style: CsvStyle
) -> tuple[bytes, int | None]:
    """Return the next stones of a lot as lines of CSV, before the first the heads; and the last, None at the end."""
    stones = stones_after(connection, lot, after, STONES_OF_A_PIECE)
    columns = columns_of_stones()
    head = [] if after else [[column.name for column in columns]]
    rows = ([_text(column.cell(record)) for column in columns] for _, record in stones)
    return csv_text([*head, *rows], style, is_first=not after).encode(), _last(stones)


def parquet_piece(connection: sqlite3.Connection, lot: str, after: int, path: Path) -> int | None:
    """Write the next stones of a lot as a Parquet file of one row group; return the last one, None at the end."""
    import pyarrow  # here: it takes 60 MB, which only the process needs that is asked for a table
    from pyarrow import parquet

    stones = stones_after(connection, lot, after, STONES_OF_A_PIECE)
    columns = columns_of_stones()
    types = {
        ColumnKind.NUMBER: pyarrow.float64(),
        ColumnKind.INTEGER: pyarrow.int64(),
        ColumnKind.BOOLEAN: pyarrow.bool_(),
        ColumnKind.TIME: pyarrow.timestamp("us", "UTC"),
    }
    fields = [
        pyarrow.field(
            column.name,
            types.get(column.kind, pyarrow.string()),
            metadata={"description": column.description} | ({"unit": column.unit} if column.unit else {}),
        )
        for column in columns
    ]
    values = [[column.cell(record) for _, record in stones] for column in columns]
    table = pyarrow.table(values, schema=pyarrow.schema(fields, metadata={"lot": lot}))
    parquet.write_table(table, path, compression=COMPRESSION)
    return _last(stones)


def join_parquet(pieces: Sequence[Path], path: Path) -> None:
    """Write the Parquet file of the row groups of all pieces, one in memory at a time."""
    from pyarrow import parquet  # here: as above

    with parquet.ParquetWriter(path, parquet.read_schema(pieces[0]), compression=COMPRESSION) as writer:
        for piece in pieces:
            writer.write_table(parquet.read_table(piece))


def _last(stones: Sequence[tuple[int, Any]]) -> int | None:
    return stones[-1][0] if len(stones) == STONES_OF_A_PIECE else None


def _text(cell: Cell) -> Cell:
    if isinstance(cell, bool):
        return "true" if cell else "false"
    return rfc3339(cell) if isinstance(cell, datetime) else cell
