"""Show a configuration without what must stay secret."""

import re
from typing import Any

SECRET_NAME = re.compile(
    r"sha256|secret|token|password|passphrase|credential|private|signature", re.IGNORECASE
)
USER_IN_URL = re.compile(r"(?<=://)[^/@\s]+@")
REDACTED = "redacted"


def redacted(document: Any) -> Any:
    """Return a document with the value of every member whose name tells of a secret replaced, and users in URLs."""
    match document:
        case dict():
            return {
                name: REDACTED
                if SECRET_NAME.search(name) and value not in (None, "", (), [])
                else redacted(value)
                for name, value in document.items()
            }
        case list() | tuple():
            return [redacted(each) for each in document]
        case str():
            return USER_IN_URL.sub(f"{REDACTED}@", document)
    return document
