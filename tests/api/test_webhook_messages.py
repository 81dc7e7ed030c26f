"""Messages of webhooks keep to their schemas in `deploy/openapi.json`, whatever the event."""

import json
from dataclasses import asdict, replace
from datetime import UTC, datetime
from typing import Any

import jsonschema_rs
import pytest
from support.rest import GOOD_HEALTH, SICK_HEALTH

from pipeline.gradation.control_chart import RuleName
from service.base.status import AcquisitionState, CheckStatus, HealthCheck
from service.calibration.files import Activation
from service.calibration.verifications import Verification, VerificationState
from service.daemon.alarming import LASTING_S, Alarming, acquisition_changed, verification_ended
from service.daemon.rest.openapi import openapi_text
from service.daemon.shift_sheets import note_end
from service.delivery.posting import message_of, trial_message
from service.health.alarms.alarms import open_alarms
from service.lots.lots import LotDefinition, close_lot, open_lot, void_lot
from service.lots.products import ProductDefinition, save_product
from service.lots.shifts import shift_at
from service.lots.trends.control_documents import DriftedFigure, ProductDrift
from service.lots.trends.diary import DiaryKind, DiaryRequest, note_entry
from service.store import Store
from service.store.event_log import EventLog
from service.store.events import EventType, NewEvent, events_after

TIME = "2026-03-01T12:00:00.000Z"


@pytest.fixture(scope="module")
def schema() -> dict[str, Any]:
    """Return the schema of all messages."""
    document = json.loads(openapi_text())
    body = document["webhooks"]["event"]["post"]["requestBody"]["content"]["application/json"]["schema"]
    return {**body, "components": document["components"]}


async def events_of_all_kinds(store: Store) -> list[dict[str, Any]]:
    """Return events that the parts of the daemon have noted, of every schema."""
    definition = ProductDefinition(title="8/16", density_kg_m3=2700.0, lower_mm=8.0, upper_mm=16.0)
    await store.write(save_product, "basalt-8-16", definition, "test")
    await store.write(open_lot, LotDefinition(lot="L1"), "basalt-8-16", None, "test")
    await store.write(close_lot, "L1", 24.5, "test")
    await store.write(void_lot, "L1", "wrong belt", "test")
    await store.write(note_entry, DiaryRequest(kind=DiaryKind.GAP, value=25.0), "test")
    await store.write(note_end, shift_at(datetime.now(UTC).astimezone(), ("06:00",), 1), is_told=True)
    log = EventLog(store)
    alarming = Alarming(await open_alarms(store, log), log)
    alarming.look(GOOD_HEALTH, 0.0)
    broken = {"trigger_line": HealthCheck(status=CheckStatus.FAIL, detail="no image")}
    for now_s in (1.0, 1.0 + LASTING_S):
        alarming.look(replace(SICK_HEALTH, checks=broken), now_s)
    await alarming.alarms.acknowledge(1, "test")
    activation = Activation(id="0002", calibration_id="ab12", at=TIME, by="test")
    log.note(
        acquisition_changed(AcquisitionState.HELD, "no cameras"),
        verification_ended(
            Verification(
                id="0001",
                state=VerificationState.CANCELLED,
                diameter_mm=15.0,
                count=5,
                calibration_id="ab12",
                created_at=TIME,
                changed_at=TIME,
            )
        ),
        NewEvent(
            type=EventType.PRODUCT_DRIFTING,
            subject="basalt-8-16",
            data=ProductDrift(
                product="basalt-8-16",
                figures=[DriftedFigure(figure="d50_mm", value=12.4, centre=11.2, rules=[RuleName.EWMA])],
            ).model_dump(),
        ),
        NewEvent(type=EventType.CALIBRATION_ACTIVATED, subject="0002", data=asdict(activation)),
    )
    await log.written()
    return (await store.read(events_after, 0, 100)).items


async def test_every_message_keeps_to_its_schema(store: Store, schema: dict[str, Any]) -> None:
    events = await events_of_all_kinds(store)
    named = {event["type"].split(".")[0] for event in events}
    assert named == {each.split(".")[0] for each in EventType}
    for event in events:
        message = json.loads(message_of(event, store.instance_id).body)
        jsonschema_rs.validate(schema, message, validate_formats=True)
        large = json.loads(message_of(event | {"data": {"x": "x" * 20_000}}, store.instance_id).body)
        jsonschema_rs.validate(schema, large)
        # what the schemas say of the details is all that there is
        name = schema["discriminator"]["mapping"][event["type"]].split("/")[-1]
        data = schema["components"]["schemas"][name]["properties"]["data"]["properties"]
        details = data["details"]["anyOf"][0]["$ref"].split("/")[-1]
        assert set(event["data"]) == set(schema["components"]["schemas"][details]["properties"]), event[
            "type"
        ]
        assert not jsonschema_rs.is_valid(schema, message | {"type": "lot.lost"})
    jsonschema_rs.validate(schema, json.loads(trial_message(store.instance_id, TIME).body))


def test_every_type_has_a_schema(schema: dict[str, Any]) -> None:
    assert set(schema["discriminator"]["mapping"]) == {*EventType, "webhook.test"}
