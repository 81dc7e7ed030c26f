"""Names of file formats with their versions, such as `stonefall-rig/1`."""

import re
from typing import Any


def unread_format(found: Any, known: str) -> str:
    """Return the reason why a file's format is not read: it is of a later version than `known`, or of another kind."""
    kind, _, newest = known.rpartition("/")
    later = re.fullmatch(rf"{re.escape(kind)}/([1-9][0-9]{{0,3}})", found) if isinstance(found, str) else None
    if later is not None and int(later[1]) > int(newest):
        return f'is "{found}", of a later version: update stonefall, which reads up to "{known}"'
    return f'must be "{known}", not {found!r}'
