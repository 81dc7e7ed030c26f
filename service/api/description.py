"""What the OpenAPI document says beyond the routes: servers, tags, files, keys, common problems, examples."""

from collections.abc import Iterator
from http import HTTPStatus
from typing import Any

from service.api.examples import EXAMPLES
from service.api.idempotency import HEADER, KEY
from service.api.problems import ProblemDocument, problem_responses

DESCRIPTION = """\
The unit of a quantity ends its name: `_mm`, `_mm2`, `_mm3`, `_g`, `_px`, `_ms`. Positions are in the frame of the rig,
whose z axis points up. Times are RFC 3339 in UTC. `null` means unknown or not applicable, never zero. Later versions
add fields: ignore those that you do not know. Every answer has an `X-Request-Id`, yours if you send one: the log of the
service names it."""

SERVERS = [
    {
        "url": "http://{host}:{port}",
        "description": "The instrument; there is no TLS, which a reverse proxy adds where the network asks for it",
        "variables": {
            "host": {"default": "127.0.0.1", "description": "`[api] host`, or a name of `allowed_hosts`"},
            "port": {"default": "8080", "description": "`[api] port`"},
        },
    }
]

TAGS = {
    "overview": "What an operator's page shows at a glance, made once for all who look.",
    "session": "Sign in with a browser, by a key; programs send their key with each request.",
    "health": "Whether the next stone will be measured, and what needs attention (NAMUR NE 107).",
    "acquisition": "Arm and disarm the rig.",
    "recordings": "Record the images of the next stones.",
    "calibrations": "Calibrate the cameras from drops of a ball or of stones.",
    "verifications": "Check the rig with a ball of known diameter.",
    "results": "The feed: every outcome in order, and the consumers that follow it.",
    "particles": "Results one by one or by filter, with meshes and pictures.",
    "lots": "Products, lots and the gradation of lots (EN 933, ASTM C136), in the words of ISA-95.",
    "trends": "How rate, size and shape of the stones went over the last hours.",
    "diary": "What was done to the crusher, and what has changed since.",
    "laboratory": "Sievings of the laboratory, correlation studies, repeatability (ISO 5725-2).",
    "cameras": "State and latest frame of each camera.",
    "alarms": "Alarms: conditions that need an operator, and the remedies (ISA-18.2).",
    "events": "What happened beside results: lots, alarms, calibrations, states; a feed of its own.",
    "webhooks": "Endpoints of the plant that events are posted to, and the outcomes (Standard Webhooks).",
    "streams": "Both feeds as server-sent events.",
    "accounting": "The balance: triggers = measured + rejected + lost + in progress.",
    "audit": "Who changed what.",
    "configuration": "The settings that the daemon runs with.",
}

BINARY = {"type": "string", "format": "binary"}
KEY_PARAMETER = {
    "name": HEADER,
    "in": "header",
    "required": False,
    "description": "Repeat a request with the same key and you get its first answer again, for 24 h: it is carried"
    " out once. A new request needs a new key, such as a UUID",
    "schema": {"type": "string", "pattern": f"^{KEY.pattern}$"},
}

FORMER = {
    "Activation": "ActivationDocument",
    "Attempt": "DeliveryDocument",
    "AuditEntry": "AuditEntryDocument",
    "Caliper": "CaliperDocument",
    "CameraCoverage": "CameraCoverageDocument",
    "Contacts": "CalipersDocument",
    "Coverage": "CoverageDocument",
    "CoverageGoals": "CoverageGoalsDocument",
    "DiaryEntry": "DiaryDocument",
    "Estimate": "Figure",
    "ObservedDrop": "Drop",
    "Product": "ProductVersion",
    "ProductDefinition": "ProductRequest",
    "Repeatability": "Scatter",
    "Run": "RunDocument",
    "SampleStudy": "RepeatabilityDocument",
    "SquareHole": "SquareHoleDocument",
    "RecordingStatus": "Recording",
    "SieveSet": "SieveSetDocument",
    "Summary": "VerificationSummary",
    "Verification": "VerificationDocument",
    "VerificationParameters": "VerificationLimits",
    "VerifiedBall": "VerifiedBallDocument",
}
"""Schemas whose dataclass has another name than generated clients know them by."""


def complete(document: dict[str, Any]) -> None:
    """Add to the document of the routes what they do not say themselves."""
    schemas = document["components"]["schemas"]
    for name, former in FORMER.items():
        schemas[former] = schemas.pop(name) | {"title": former}
    problem = ProblemDocument.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas |= problem.pop("$defs") | {"Problem": problem}
    for model, example in EXAMPLES.items():
        title = getattr(model, "model_config", {}).get("title") or model.__name__
        schemas[FORMER.get(title, title)]["examples"] = [example]
    for method, operation in _operations(document):
        if method == "post" and "security" in operation:
            operation.setdefault("parameters", []).append(KEY_PARAMETER)
        _add_common_problems(method, operation)
        for answer in operation["responses"].values():
            for media_type, content in answer.get("content", {}).items():
                if not content.get("schema"):
                    content["schema"] = {"type": "object"} if media_type.endswith("json") else BINARY
    for schema in schemas.values():
        for member in schema.get("properties", {}).values():
            if "description" in member:
                member["description"] = " ".join(member["description"].split())  # lines of a docstring
    _suit_generators(document)


def _suit_generators(part: Any) -> None:
    """Give each integer its width, as Java and C# take 32 bits without one, and tuples the type of their members."""
    if isinstance(part, dict):
        if part.get("type") == "integer":
            part["format"] = "int64"
        if (name := str(part.get("$ref")).rpartition("/")[2]) in FORMER:
            part["$ref"] = f"#/components/schemas/{FORMER[name]}"
        if "prefixItems" in part:  # generators know lists, no tuples; members of ours are alike
            part["items"] = part.pop("prefixItems")[0]
        part = list(part.values())
    if isinstance(part, list):
        for inner in part:
            _suit_generators(inner)


def _operations(document: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for operations in document["paths"].values():
        yield from operations.items()


def _add_common_problems(method: str, operation: dict[str, Any]) -> None:
    """List the problems that any request of this kind can have, beside those that the route names."""
    statuses = {
        HTTPStatus.MISDIRECTED_REQUEST,
        HTTPStatus.INTERNAL_SERVER_ERROR,
        HTTPStatus.SERVICE_UNAVAILABLE,
    }
    if "security" in operation:
        statuses |= {HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN, HTTPStatus.TOO_MANY_REQUESTS}
    if "parameters" in operation or "requestBody" in operation:
        statuses.add(HTTPStatus.UNPROCESSABLE_ENTITY)
    if "requestBody" in operation:
        statuses |= {
            HTTPStatus.BAD_REQUEST,
            HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
            HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
        }
    if method == "post" and "security" in operation:
        statuses.add(HTTPStatus.CONFLICT)
    responses = operation["responses"]
    others = responses.pop("default", None)
    for status, problem in problem_responses(*sorted(statuses)).items():
        if status != "default":
            responses.setdefault(str(int(status)), problem)
    if others is not None:
        responses["default"] = others
