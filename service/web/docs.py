"""The page of documentation: the OpenAPI document by `docs.html.jinja`, without scripts or fonts from elsewhere."""

from pathlib import Path
from typing import Any

from service.base.templates import templates_in


def docs_page(document: dict[str, Any]) -> str:
    """Return the page: every operation by tag, then every schema."""
    by_tag: dict[str, list[tuple[str, str, dict[str, Any]]]] = {}
    for path, operations in (document["paths"] | document["webhooks"]).items():
        for method, operation in operations.items():
            by_tag.setdefault(operation["tags"][0], []).append((path, method.upper(), operation))
    explained = {tag["name"]: tag["description"] for tag in document["tags"]}
    template = templates_in(Path(__file__).parent).get_template("docs.html.jinja")
    return template.render(document, by_tag=by_tag, explained=explained)
