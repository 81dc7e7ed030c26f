"""Schemas of the messages that `service.delivery` posts to webhook endpoints, for the OpenAPI document."""

from collections.abc import Collection, Sequence
from typing import Any

from pydantic import TypeAdapter

from service.base.schema import TIME
from service.base.status import AcquisitionStatus
from service.calibration.files import Activation
from service.calibration.verification_limits import Summary
from service.calibration.verifications import Verification
from service.delivery.posting import TEST
from service.health.routes import AlarmDocument, HealthDocument
from service.lots.lots import LotDocument
from service.lots.trends.control_documents import ProductDrift
from service.lots.trends.diary import DiaryEntry
from service.reports.shift_data import ShiftDocument
from service.store.events import EventType
from service.web.openapi_parts import header_references


def _reference(name: str) -> dict[str, str]:
    return {"$ref": f"#/components/schemas/{name}"}


def _schema(kind: Any) -> dict[str, Any]:
    """Return the schema of a type; what it refers to is in the document, as routes answer with it."""
    found = TypeAdapter(kind).json_schema(mode="serialization", ref_template="#/components/schemas/{model}")
    return {name: value for name, value in found.items() if name != "$defs"}


def _details(
    text: str, kind: Any, names: Collection[str] = (), but: Collection[str] = (), **more: Any
) -> dict[str, Any]:
    """Return the schema of details: those fields of an answer, or all `but` some, and `more`."""
    properties = _schema(kind)["properties"]
    chosen = {name: properties[name] for name in names or properties if name not in but} | more
    return {"type": "object", "description": text, "properties": chosen, "required": list(chosen)}


DETAILS: dict[str, tuple[dict[str, Any], Sequence[EventType]]] = {
    "LotDetails": (
        _details(
            "Details of an event of a lot: the lot as it was then.",
            LotDocument,
            but=["product_version"],
            version=_schema(LotDocument)["properties"]["product_version"],
        ),
        [each for each in EventType if each.startswith("lot.")],
    ),
    "AlarmDetails": (
        _details(
            "Details of an event of an alarm; its check is the `subject`.",
            AlarmDocument,
            but=["check", "changed_at", "cause", "action", "said"],
        ),
        [each for each in EventType if each.startswith("alarm.")],
    ),
    "ActivationDetails": (
        _details("Details of `calibration.activated`.", Activation),
        [EventType.CALIBRATION_ACTIVATED],
    ),
    "VerificationDetails": (
        _details(
            "Details of `verification.ended`.",
            Verification,
            ["calibration_id", "diameter_mm", "problems"],
            outcome=_reference("VerificationState") | {"description": "Its verdict, `cancelled`, or `void`"},
            error_mm={
                "anyOf": [{"type": "number"}, {"type": "null"}],
                "description": _schema(Summary)["properties"]["error_mm"]["description"]
                + " Null without a ball.",
            },
        ),
        [EventType.VERIFICATION_ENDED],
    ),
    "AcquisitionDetails": (
        _details("Details of `acquisition.changed`.", AcquisitionStatus, ["state", "trouble"]),
        [EventType.ACQUISITION_CHANGED],
    ),
    "DriftDetails": (_details("Details of `product.drifting`.", ProductDrift), [EventType.PRODUCT_DRIFTING]),
    "DiaryDocument": (_schema(DiaryEntry), [EventType.DIARY_NOTED]),
    "ShiftDocument": (_schema(ShiftDocument), [EventType.SHIFT_ENDED]),
    "HealthDetails": (
        _details(
            "Details of `health.changed`.",
            HealthDocument,
            ["ne107", "reasons"],
            before={
                "anyOf": [_reference("Ne107"), {"type": "null"}],
                "description": "The word before; null at the start",
            },
        ),
        [EventType.HEALTH_CHANGED],
    ),
}
"""Schema of the details, and the types of events that have them, by name."""


def _message(types: Sequence[str], seq: dict[str, Any], details: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a message."""
    data = {
        "instance_id": {"type": "string", "description": "Identity of the history of results"},
        "seq": {"description": "`seq` of the event in `/events`", **seq},
        "subject": {"type": "string", "description": "What the event is of, as in `/events`"},
        "details": {"description": "`data` of the event; null where it is too large", **details},
    }
    fields = {
        "type": {"type": "string", "enum": list(types), "description": "What happened"},
        "timestamp": {"type": "string", **TIME, "description": "When it happened, RFC 3339 UTC"},
        "data": {"description": "The event", **_object(data)},
    }
    return {"description": f"Message of {', '.join(f'`{each}`' for each in types)}.", **_object(fields)}


def _object(fields: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": fields, "required": list(fields)}


MESSAGES: dict[str, Any] = {
    f"{details.removesuffix('Details').removesuffix('Document')}Message": _message(
        types, {"type": "integer"}, {"anyOf": [_reference(details), {"type": "null"}]}
    )
    for details, (_, types) in DETAILS.items()
} | {"TestMessage": _message([TEST], {"type": "null"}, {"type": "object"})}
"""Schemas of the messages, by name."""

SIGNATURE = {
    "webhook-id": "Id of the message, the same at each attempt: drop those that are there",
    "webhook-timestamp": "Seconds since 1970 at which the message was signed",
    "webhook-signature": "`v1,` and the HMAC-SHA256 of id, timestamp and body in Base64; several, separated by spaces,"
    " while two secrets are in use",
}
WEBHOOKS = {
    "event": {
        "post": {
            "tags": ["messages"],
            "summary": "Receive an event",
            "description": "Receive an event that the endpoint is configured for: in their order, each at least once."
            " Verify the signature (Standard Webhooks), store the message, then answer 2xx within 15 s."
            " Later versions add types.",
            "operationId": "receive_event",
            "parameters": [
                {
                    "name": name,
                    "in": "header",
                    "required": True,
                    "description": text,
                    "schema": {"type": "string"},
                }
                for name, text in SIGNATURE.items()
            ],
            "requestBody": {
                "required": True,
                "content": {
                    "application/json": {
                        "schema": {
                            "oneOf": [_reference(name) for name in MESSAGES],
                            "discriminator": {
                                "propertyName": "type",
                                "mapping": {
                                    each: f"#/components/schemas/{name}"
                                    for name, message in MESSAGES.items()
                                    for each in message["properties"]["type"]["enum"]
                                },
                            },
                        }
                    }
                },
            },
            "responses": {
                "2XX": {"description": "The message is stored"},
                "410": {"description": "The endpoint is disabled at once"},
                "default": {
                    "description": "The message is repeated; `Retry-After` counts with 429 and 503, an hour at most",
                    "headers": header_references(["Retry-After"]),
                },
            },
        }
    }
}
"""The one webhook: every endpoint receives all types that it is configured for."""
