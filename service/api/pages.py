"""Pages of results as JSON, written off the loop and record by record."""

import asyncio
import json
from collections.abc import Mapping, Sequence
from typing import Any

from fastapi.responses import Response

from service.results.fields import completed
from service.store import Record


async def page_of(head: Mapping[str, Any], items: Sequence[Record]) -> Response:
    """The members of `head`, and the results as `items`."""
    return Response(await asyncio.to_thread(_written, head, items), media_type="application/json")


def _written(head: Mapping[str, Any], items: Sequence[Record]) -> bytes:
    # a thousand records in one call would hold the interpreter's lock for a tenth of a second
    members = [f"{_json(name)}:{_json(value)}" for name, value in head.items()]
    records = [_json(completed(record)) for record in items]
    members.append(f'"items":[{",".join(records)}]')
    return f"{{{','.join(members)}}}".encode()


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
