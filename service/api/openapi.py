"""The interface described: OpenAPI 3.1, served, committed as `deploy/openapi.json` and compared by a test.

Run `python -m service.api.openapi > deploy/openapi.json` after a change, and raise `API_VERSION` with it.
"""

import json
import sys
from typing import Any

from fastapi import FastAPI

from service.api.schemas import ProblemDocument


def describe(app: FastAPI) -> None:
    """Add to the app's description the shape of every error."""
    generate = app.openapi

    def openapi() -> dict[str, Any]:
        document = generate()
        schemas = document["components"]["schemas"]
        if "Problem" not in schemas:
            problem = ProblemDocument.model_json_schema(ref_template="#/components/schemas/{model}")
            schemas |= problem.pop("$defs") | {"Problem": problem}
        return document

    app.openapi = openapi  # type: ignore[method-assign]  # FastAPI's documented way to extend it


def openapi_text() -> str:
    """Write the document as it is committed."""
    from service.api.app import build_routes  # which imports this module

    return json.dumps(build_routes().openapi(), indent=2, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    sys.stdout.write(openapi_text())
