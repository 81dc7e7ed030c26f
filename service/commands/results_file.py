"""Read the records that `stonefall measure` wrote."""

import json
from pathlib import Path
from typing import Any

from service.base.errors import ServiceError
from service.commands.measured_recording import RESULTS
from service.results.fields import completed


def read_results(results: Path) -> list[dict[str, Any]]:
    """Return the records in a folder of results, or in a file `results.jsonl`.

    Raises
    ------
    ServiceError
        It cannot be read; names the file and the line.
    """
    path = results / RESULTS if results.is_dir() else results
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as err:
        raise ServiceError(f"{path}: {err}") from err
    records = []
    for number, line in enumerate(lines, start=1):
        try:
            records.append(completed(dict(json.loads(line))))
        except (ValueError, TypeError) as err:
            raise ServiceError(f"{path}: line {number}: {err}") from err
    return records
