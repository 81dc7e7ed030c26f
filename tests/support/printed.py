"""What a benchmark has measured: as tables for people, or as JSON for `tests/benchmarks/figures.py`."""

import json
import sys

from rich.console import Console
from rich.table import Table


def show(*tables: Table, as_json: bool, width: int = 150) -> None:
    """Print tables, `width` characters wide in a file; as JSON each row maps headings to cells, as they are printed."""
    if as_json:
        rows = [
            {str(column.header): str(cell) for column, cell in zip(table.columns, cells, strict=True)}
            for table in tables
            for cells in zip(*(column.cells for column in table.columns), strict=True)
        ]
        sys.stdout.write(json.dumps(rows, indent=1) + "\n")
        return
    console = Console(width=None if sys.stdout.isatty() else width)
    for table in tables:
        console.print(table)
