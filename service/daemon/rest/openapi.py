"""The OpenAPI 3.1 document, which is served, committed as `deploy/openapi.json`, and compared by a test.

Run `python -m service.daemon.rest.openapi > deploy/openapi.json` after a change, and raise `API_VERSION` with it.
"""

import json
import re
import sys

from service.daemon.rest.app import build_routes

MAX_LINE = 110


def openapi_text() -> str:
    """Return the document as it is committed, with lists of words on one line."""
    text = json.dumps(build_routes().openapi(), indent=2, ensure_ascii=False) + "\n"
    return re.sub(r"\[\n[^][{}]+\]", _one_line, text)


def _one_line(found: re.Match[str]) -> str:
    line = re.sub(r"\n *", " ", found[0]).replace("[ ", "[").replace(" ]", "]")
    return line if len(line) <= MAX_LINE else found[0]


if __name__ == "__main__":
    sys.stdout.write(openapi_text())
