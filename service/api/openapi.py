"""The OpenAPI 3.1 document, which is served, committed as `deploy/openapi.json`, and compared by a test.

Run `python -m service.api.openapi > deploy/openapi.json` after a change, and raise `API_VERSION` with it.
"""

import json
import sys

from service.api.app import build_routes


def openapi_text() -> str:
    """Return the document as it is committed."""
    return json.dumps(build_routes().openapi(), indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    sys.stdout.write(openapi_text())
