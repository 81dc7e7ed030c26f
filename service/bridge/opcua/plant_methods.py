"""The methods: open and close a lot, acknowledge an alarm, get results that were missed, refresh conditions."""

import json
import logging
from collections.abc import Awaitable, Callable, Iterator, Sequence
from typing import Any
from urllib.parse import quote

from asyncua import ua
from asyncua.common.event_objects import BaseEvent, RefreshEndEvent, RefreshStartEvent
from asyncua.ua import ObjectIds as Ids
from asyncua.ua import VariantType as Type

from drivers.files.bounded import read_bounded
from service.bridge.opcua.access import PlantUser
from service.bridge.opcua.alarms import PlantConditions
from service.bridge.opcua.bounded_server import BoundedServer
from service.bridge.opcua.methods import Caller, ServedMethod
from service.bridge.opcua.nodes import ROOT
from service.bridge.opcua.results import LEAN
from service.bridge.plant import OrderRefusedError, Plant
from service.bridge.reference_client import ProblemError

log = logging.getLogger(__name__)

MAX_RESULTS = 100
"""Results that one call of GetResults returns at most."""
MAX_KEY_BYTES = 4096
REFUSED_SEVERITY = 400
TEXT = Type.String
PROBLEM = {"Error": Type.Int32, "Problem": TEXT}
"""Last outputs of each method: 0, or -1 and why it was refused."""
DONE = (0, "")
STATUS_OF = {
    "unknown-alarm": ua.StatusCodes.BadEventIdUnknown,
    "alarm-conflict": ua.StatusCodes.BadConditionBranchAlreadyAcked,
    "unauthorized": ua.StatusCodes.BadUserAccessDenied,
    "forbidden": ua.StatusCodes.BadUserAccessDenied,
    "": ua.StatusCodes.BadNoCommunication,
}
"""Status of a refused acknowledgement, by kind of problem; empty: the daemon does not answer."""

Order = Callable[[str | None], Awaitable[object]]


def plant_methods(plant: Plant, conditions: PlantConditions, server: BoundedServer) -> Iterator[ServedMethod]:
    """Yield all methods of a server."""

    async def ordered(caller: Caller, what: str, order: Order) -> OrderRefusedError | ua.StatusCode | None:
        """Give an order with the key of the user; return why it was refused."""
        user = caller.user
        who = f"{user.name or 'anonymous'} at {caller.address}"
        if not isinstance(user, PlantUser) or not user.may_order:
            log.warning("refused: %s: %s: has no key for orders", who, what)
            return ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)
        file = user.key_file
        try:
            await order(None if file is None else read_bounded(file, MAX_KEY_BYTES).decode("ascii").strip())
        except (OSError, ValueError):
            refusal = OrderRefusedError("the key file of this user cannot be read", "unauthorized")
        except OrderRefusedError as err:
            refusal = err
        else:
            log.info("%s: %s", who, what)
            return None
        log.warning("refused: %s: %s: %s", who, what, refusal)
        told = BaseEvent(message=f"{what} by {user.name}: {refusal}", severity=REFUSED_SEVERITY)
        told.SourceName = ROOT
        await server.emit(told)
        return refusal

    async def answered(caller: Caller, what: str, order: Order) -> Sequence[object] | ua.StatusCode:
        refusal = await ordered(caller, what, order)
        if isinstance(refusal, ua.StatusCode):
            return refusal
        return DONE if refusal is None else (-1, str(refusal))

    async def open_lot(
        caller: Caller, _: ua.NodeId, lot: str | None, product: str | None, *more: str | None
    ) -> Sequence[object] | ua.StatusCode:
        given = {name: text for name, text in zip(("closes", "order"), more, strict=True) if text}

        def order(token: str | None) -> Awaitable[object]:
            return plant.open_lot(lot or "", product or "", token, **given)

        return await answered(caller, f"open lot {lot}", order)

    async def close_lot(caller: Caller, _: ua.NodeId, lot: str | None) -> Sequence[object] | ua.StatusCode:
        return await answered(caller, f"close lot {lot}", lambda token: plant.close_lot(lot or "", token))

    async def acknowledge(
        caller: Caller, condition: ua.NodeId, event_id: bytes, comment: object
    ) -> Sequence[object] | ua.StatusCode:
        alarm = conditions.alarm_of(condition, event_id)
        if alarm is None:
            return ua.StatusCode(ua.StatusCodes.BadEventIdUnknown)
        refusal = await ordered(
            caller, f"acknowledge {alarm.check}", lambda token: plant.acknowledge(alarm.id, token)
        )
        if isinstance(refusal, OrderRefusedError):
            return ua.StatusCode(STATUS_OF.get(refusal.kind, ua.StatusCodes.BadInvalidState))
        return () if refusal is None else refusal

    async def refresh(caller: Caller, _: ua.NodeId, subscription: int, *__: int) -> ua.StatusCode:
        if not caller.owns(subscription):
            return ua.StatusCode(ua.StatusCodes.BadSubscriptionIdInvalid)
        for event in (RefreshStartEvent(), *conditions.retained(), RefreshEndEvent()):
            await server.emit(event, subscription)
        return ua.StatusCode()

    async def get_result(_: Caller, __: ua.NodeId, result_id: str | None, ___: int) -> Sequence[object]:
        try:
            found = await plant.get(f"/particles/{quote(result_id or '', safe='')}")
        except OrderRefusedError as err:
            return (0, "", -1, str(err))
        return (0, lean_json(found), *DONE)

    async def get_results(_: Caller, __: ua.NodeId, after: int, limit: int) -> Sequence[object]:
        try:
            page = await plant.get(
                "/results", after=after, limit=min(max(limit, 1), MAX_RESULTS), fields="lean"
            )
        except OrderRefusedError as err:
            problem = err.__cause__.problem if isinstance(err.__cause__, ProblemError) else {}
            return ("", int(problem.get("first_seq", 0)), int(problem.get("last_seq", 0)), [], -1, str(err))
        items = [json.dumps(item) for item in page["items"]]
        return (page["instance_id"], page["first_seq"], page["last_seq"], items, *DONE)

    lots, results = f"{ROOT}.Lot", f"{ROOT}.ResultManagement"
    yield ServedMethod(
        open_lot, {"Lot": TEXT, "Product": TEXT, "Closes": TEXT, "Order": TEXT}, PROBLEM, f"{lots}.OpenLot",
        "Opens a lot. Closes: the open one whose place it takes; Order: the number of the order; both may be empty",
    )  # fmt: skip
    yield ServedMethod(close_lot, {"Lot": TEXT}, PROBLEM, f"{lots}.CloseLot", "Closes a lot")
    yield ServedMethod(
        get_result, {"ResultId": TEXT, "Timeout": Type.Int32}, {"ResultHandle": Type.UInt32, "Result": TEXT, **PROBLEM},
        f"{results}.GetResultById", "The newest revision of a result, as JSON",
    )  # fmt: skip
    yield ServedMethod(
        get_results, {"After": Type.UInt64, "Limit": Type.UInt32},
        {"HistoryId": TEXT, "FirstSeq": Type.UInt64, "LastSeq": Type.UInt64, "Results": [TEXT], **PROBLEM},
        f"{results}.GetResults", f"Results after a sequence number, as JSON, {MAX_RESULTS} at most",
    )  # fmt: skip
    number = Type.UInt32
    yield ServedMethod(
        acknowledge, {"EventId": Type.ByteString, "Comment": Type.LocalizedText}, {},
        standard=Ids.AcknowledgeableConditionType_Acknowledge,
    )  # fmt: skip
    yield ServedMethod(refresh, {"SubscriptionId": number}, {}, standard=Ids.ConditionType_ConditionRefresh)
    yield ServedMethod(
        refresh, {"SubscriptionId": number, "MonitoredItemId": number}, {},
        standard=Ids.ConditionType_ConditionRefresh2,
    )  # fmt: skip


def lean_json(result: dict[str, Any]) -> str:
    """Return the fields of a result that events have, as JSON."""
    return json.dumps({name: result.get(name) for name in LEAN})
