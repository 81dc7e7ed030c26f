"""What the OpenAPI document says beyond the routes: servers, tags, summaries, headers, problems, examples."""

import re
from http import HTTPStatus
from typing import Any

from service.daemon.rest.examples import EXAMPLES
from service.daemon.rest.webhook_messages import DETAILS, MESSAGES, WEBHOOKS
from service.web.idempotency import HEADER, KEY, REPLAYED
from service.web.openapi_parts import HEADERS, header_references, shared_answer, shared_answers, shorten
from service.web.problems import ProblemDocument

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
    "shifts": "Shifts by the host's local time, each with a sheet of one page.",
    "trends": "How rate, size and shape of the stones went over the last hours.",
    "diary": "What was done to the crusher, and what has changed since.",
    "laboratory": "Sievings of the laboratory, correlation studies, repeatability (ISO 5725-2).",
    "cameras": "State and latest frame of each camera.",
    "alarms": "What needs somebody now, and what to do (ISA-18.2).",
    "events": "What happened beside results: lots, alarms, calibrations, states; a feed of its own.",
    "webhooks": "Endpoints of the plant that events are posted to, and the outcomes (Standard Webhooks).",
    "messages": "What these endpoints receive.",
    "streams": "Both feeds as server-sent events.",
    "accounting": "The balance: triggers = measured + rejected + lost + in progress.",
    "audit": "Who changed what.",
    "configuration": "The settings that the daemon runs with.",
}

BINARY = {"type": "string", "format": "binary"}
KEY_PARAMETER = {
    "name": HEADER,
    "in": "header",
    "description": "Repeat a request with the same key and you get its first answer again, for 24 h: it is carried"
    " out once. A new request needs a new key, such as a UUID",
    "schema": {"type": "string", "pattern": f"^{KEY.pattern}$"},
}


ANSWERS = ("Calibrations", "Recordings", "Standards", "Verifications")
STATES = ("Acquisition", "Camera", "Recording")
DOCUMENTS = (
    *("Activation", "AuditEntry", "Caliper", "CameraCoverage", "Coverage", "CoverageGoals"),
    *("Run", "SieveSet", "SquareHole", "Verification", "VerifiedBall"),
)
FORMER = {
    **{f"{name}Answer": name for name in ANSWERS},
    **{f"{name}Status": name for name in STATES},
    **{name: f"{name}Document" for name in DOCUMENTS},
    "Attempt": "DeliveryDocument",
    "Contacts": "CalipersDocument",
    "DiaryEntry": "DiaryDocument",
    "Estimate": "Figure",
    "ObservedDrop": "Drop",
    "Product": "ProductVersion",
    "ProductDefinition": "ProductRequest",
    "MappingForm": "Form",
    "Repeatability": "Scatter",
    "SampleStudy": "RepeatabilityDocument",
    "Summary": "VerificationSummary",
    "VerificationParameters": "VerificationLimits",
}
"""Schemas whose dataclass has another name than generated clients know them by."""


def complete(document: dict[str, Any]) -> None:
    """Add to the document of the routes what they do not say themselves."""
    components = document["components"]
    components |= {"headers": HEADERS, "responses": shared_answers()}
    schemas = {FORMER.get(name, name): schema for name, schema in components["schemas"].items()}
    schemas = components["schemas"] = {name: schemas[name] | {"title": name} for name in sorted(schemas)}
    problem = ProblemDocument.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas |= problem.pop("$defs") | {"Problem": problem} | MESSAGES
    schemas |= {name: schema for name, (schema, _) in DETAILS.items()}
    document["webhooks"] = WEBHOOKS
    for model, example in EXAMPLES.items():
        title = getattr(model, "model_config", {}).get("title") or model.__name__
        schemas[FORMER.get(title, title)]["examples"] = [example]
    for path, operations in document["paths"].items():
        has_items = any(re.fullmatch(rf"{re.escape(path)}/\{{\w+\}}", other) for other in document["paths"])
        for method, operation in operations.items():
            operation["summary"] = _summary(operation["description"])
            if method == "post" and "security" in operation:
                operation.setdefault("parameters", []).append(KEY_PARAMETER)
            _add_headers(operation, makes_item=method == "post" and has_items)
            _add_shared_answers(operation, method)
            _add_schemas(operation)
    for schema in schemas.values():
        for member in schema.get("properties", {}).values():
            if "description" in member:
                member["description"] = " ".join(member["description"].split())  # lines of a docstring
    _suit_generators(document)
    shorten(document)


def _summary(description: str) -> str:
    """Return a description up to its first stop, colon, semicolon or comma."""
    return re.split(r"[.;:,](?:\s|$)", description, maxsplit=1)[0].replace("`", "")


def _add_headers(operation: dict[str, Any], *, makes_item: bool) -> None:
    """Describe the headers of the answers that are no problems."""
    answers = operation["responses"]
    names = {each["name"] for each in operation.get("parameters", ())}
    headers = {
        "ETag": "304" in answers or "if-match" in names,
        REPLAYED: HEADER in names,
        "Location": "201" in answers and makes_item,
    }
    present = header_references(name for name, is_there in headers.items() if is_there)
    for status, answer in answers.items():
        if status < "300" and present:
            answer["headers"] = present | answer.get("headers", {})


def _add_shared_answers(operation: dict[str, Any], method: str) -> None:
    """Refer to 304 and the problems that the route names, and to those that any request of this kind can have."""
    parameters = operation.get("parameters", ())
    statuses = {
        HTTPStatus.MISDIRECTED_REQUEST,
        HTTPStatus.INTERNAL_SERVER_ERROR,
        HTTPStatus.SERVICE_UNAVAILABLE,
    }
    if "security" in operation:
        statuses |= {HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN, HTTPStatus.TOO_MANY_REQUESTS}
    if parameters or "requestBody" in operation:
        statuses.add(HTTPStatus.UNPROCESSABLE_ENTITY)
    if "requestBody" in operation:
        statuses |= {
            HTTPStatus.BAD_REQUEST,
            HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
            HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
        }
    if method == "post" and "security" in operation:
        statuses.add(HTTPStatus.CONFLICT)
    if method != "put" and any(each["in"] == "path" and "$ref" not in each["schema"] for each in parameters):
        statuses.add(HTTPStatus.NOT_FOUND)  # a name that nothing has; PUT may give it
    if any(each["name"] == "if-match" for each in parameters):
        statuses.add(HTTPStatus.PRECONDITION_FAILED)
    answers = operation["responses"]
    named = {status for status in answers if status >= "300"}  # `default` among them
    for status in sorted(named | {str(int(status)) for status in statuses}):
        answers.pop(status, None)  # so that they stand in order
        answers[status] = shared_answer(status)


def _add_schemas(operation: dict[str, Any]) -> None:
    """Describe content without a schema: JSON as an object, anything else as a file."""
    for answer in operation["responses"].values():
        for media_type, content in answer.get("content", {}).items():
            if not content.get("schema"):
                content["schema"] = {"type": "object"} if media_type.endswith("json") else BINARY


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
