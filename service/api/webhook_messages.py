"""Schemas of the messages that `service.delivery` posts to webhook endpoints, for the OpenAPI document."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel, Field, create_model
from pydantic.json_schema import models_json_schema

from service.api.openapi_parts import header_references
from service.api.routes.acquisition import Acquisition
from service.api.routes.alarms import AlarmDocument
from service.api.routes.health import HealthDocument
from service.api.routes.verifications import VerificationDocument
from service.base.schema import TIME
from service.base.status import Ne107, Report
from service.calibration.verifications import VerificationState
from service.delivery.message import TEST
from service.lots.figures import LotDocument
from service.lots.trends.trend import DiaryDocument
from service.store.events import EventType


class ActivationDetails(Report):
    """Details of `calibration.activated`."""

    id: str = Field(description="Name of the calibration in the addresses")
    calibration_id: str = Field(description="Checksum of its rig file, which results name")
    at: str = Field(description="When it was activated, RFC 3339 UTC", json_schema_extra=TIME)
    by: str | None = Field(description="Who activated it; null: unknown")


def _details(name: str, text: str, model: type[BaseModel], *names: str, **more: Any) -> type[BaseModel]:
    """Return a model with some fields of a document, and `more`."""
    fields: dict[str, Any] = {
        each: (model.model_fields[each].annotation, model.model_fields[each]) for each in names
    }
    return create_model(name, __base__=Report, __doc__=text, **fields, **more)


def _others(model: type[BaseModel], *left_out: str) -> Sequence[str]:
    return [name for name in model.model_fields if name not in left_out]


LOT = _details(
    "LotDetails",
    "Details of an event of a lot: the lot as it was then.",
    LotDocument,
    *_others(LotDocument, "product_version"),
    version=(int, LotDocument.model_fields["product_version"]),
)
ALARM = _details(
    "AlarmDetails",
    "Details of an event of an alarm; its check is the `subject`.",
    AlarmDocument,
    *_others(AlarmDocument, "check", "changed_at", "cause", "action"),
)
VERIFICATION = _details(
    "VerificationDetails",
    "Details of `verification.ended`.",
    VerificationDocument,
    *("calibration_id", "diameter_mm", "problems"),
    outcome=(VerificationState, Field(description="Its verdict, `cancelled`, or `void`")),
    error_mm=(
        float | None,
        Field(description="Mean of the equivalent diameters minus the true one, mm; null without a ball"),
    ),
)
ACQUISITION = _details(
    "AcquisitionDetails", "Details of `acquisition.changed`.", Acquisition, "state", "trouble"
)
HEALTH = _details(
    "HealthDetails",
    "Details of `health.changed`.",
    HealthDocument,
    *("ne107", "reasons"),
    before=(Ne107 | None, Field(description="The word before; null at the start")),
)
DETAILS: Mapping[type[BaseModel], Sequence[EventType]] = {
    LOT: tuple(each for each in EventType if each.startswith("lot.")),
    ALARM: tuple(each for each in EventType if each.startswith("alarm.")),
    ActivationDetails: (EventType.CALIBRATION_ACTIVATED,),
    VERIFICATION: (EventType.VERIFICATION_ENDED,),
    ACQUISITION: (EventType.ACQUISITION_CHANGED,),
    DiaryDocument: (EventType.DIARY_NOTED,),
    HEALTH: (EventType.HEALTH_CHANGED,),
}
"""Types of events by the model of their details."""


def details_schemas() -> dict[str, Any]:
    """Return the schemas of the details, and of what they refer to, by name."""
    _, found = models_json_schema(
        [(model, "serialization") for model in DETAILS], ref_template="#/components/schemas/{model}"
    )
    schemas: dict[str, Any] = found["$defs"]
    return schemas


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


def _reference(name: str) -> dict[str, str]:
    return {"$ref": f"#/components/schemas/{name}"}


def _message_name(details: type[BaseModel]) -> str:
    return details.__name__.removesuffix("Details").removesuffix("Document") + "Message"


MESSAGES: dict[str, Any] = {
    _message_name(details): _message(
        types, {"type": "integer"}, {"anyOf": [_reference(details.__name__), {"type": "null"}]}
    )
    for details, types in DETAILS.items()
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
