"""The OPC UA server as foreign clients see it: asyncua's own, secured and not, friendly and hostile."""

import asyncio
import json
import logging
import math
import re
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua
from asyncua.common.subscription import Subscription
from asyncua.ua.uaerrors import (
    BadEventIdUnknown,
    BadIdentityTokenRejected,
    BadMethodInvalid,
    BadNotWritable,
    BadSessionIdInvalid,
    BadSubscriptionIdInvalid,
    BadTooManySessions,
    BadUserAccessDenied,
    UaError,
)  # fmt: skip
from support.eventually import PATIENCE_S, soon
from support.opcua import (
    ARMED,
    GATE,
    FakePlant,
    Heard,
    Identity,
    make_identity,
    node_of,
    result,
    secured,
)  # fmt: skip

from pipeline.gradation.estimates import Estimate, State
from pipeline.gradation.specification import Verdict
from service.base.status import Ne107
from service.bridge.opcua import connections, sessions
from service.bridge.opcua import outlet as outlet_module
from service.bridge.opcua.access import Access
from service.bridge.opcua.certificates import now_utc, own_certificate, thumbprint
from service.bridge.opcua.nodes import SHOWN
from service.bridge.opcua.outlet import OpcUaOutlet
from service.bridge.opcua.passwords import hash_password
from service.bridge.opcua.results import POSITION, latest
from service.bridge.opcua.settings import OpcUaSettings, OpcUaUser
from service.bridge.opcua.space import INDEX, UNITS
from service.bridge.plant import OrderRefusedError

pytestmark = pytest.mark.asyncio(loop_scope="module")

URI = "urn:tests:server"
GUIDE = Path(outlet_module.__file__).with_name("README.md")


@dataclass(frozen=True)
class Served:
    """A server of a plant, and who may use it."""

    url: str
    plant: FakePlant
    folder: Path
    outlet: OpcUaOutlet
    client: Identity
    stranger: Identity

    @asynccontextmanager
    async def operator(self, name: str = "operator", word: str = "right") -> AsyncIterator[Client]:
        async with await secured(self.url, self.client, (name, word)) as client:
            yield client


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def served(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Served]:
    folder = tmp_path_factory.mktemp("opcua")
    plant = FakePlant(folder)
    key_file = folder / "operator.key"
    key_file.write_text("token-of-the-operator\n")
    own = own_certificate(folder / "opcua", URI, "localhost", now_utc())
    client, stranger = make_identity(folder, "client"), make_identity(folder, "stranger")
    (folder / "opcua" / "trusted" / "client.der").write_bytes(client.der)
    users = (
        OpcUaUser(name="operator", password=hash_password("right"), key_file=key_file),
        OpcUaUser(name="reader", password=hash_password("right")),
        OpcUaUser(name="deputy", password=hash_password("right"), orders=True),
        OpcUaUser(name="line", certificate=client.certificate, key_file=key_file),
    )
    outlet = OpcUaOutlet(plant, Access(folder / "opcua", users))  # type: ignore[arg-type]  # stands for one
    await outlet.start(OpcUaSettings(port=0, users=users), URI, own)
    tasks = [asyncio.create_task(outlet.show()), asyncio.create_task(outlet.send())]
    yield Served(
        f"opc.tcp://127.0.0.1:{outlet.port}/stonefall", plant, folder / "opcua", outlet, client, stranger
    )
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    await outlet.stop()


@pytest.fixture(autouse=True)
def good_pace(served: Served) -> None:
    """No test is refused for what those before it did."""
    served.outlet.access._wrong.clear()
    served.outlet.access._told.clear()


async def shown(client: Client, path: str) -> ua.DataValue:
    return await (await node_of(client, path)).read_data_value(raise_on_bad_status=False)


async def test_while_the_daemon_does_not_answer_all_is_bad_and_nothing_is_zero(served: Served) -> None:
    served.plant.be(daemon_answers=False, trouble="no answer: refused")
    async with Client(served.url) as client:
        await soon(lambda: _is(client, "Trouble", "no answer: refused"))
        for path in ("Lot.Stones", "Figures.D50", "Counts.Measured", "DeviceHealth", "Ready"):
            value = await shown(client, path)
            assert value.StatusCode.value == ua.StatusCodes.BadNoCommunication, path
            assert value.Value.Value is None
        assert (await shown(client, "DaemonAnswers")).Value.Value is False


async def test_state_and_lot_are_seen_as_they_change_with_units_and_times(served: Served) -> None:
    served.plant.be(**_fields(ARMED))
    heard = Heard()
    async with Client(served.url) as client:
        await soon(lambda: _is(client, "Lot.IsOpen", False))
        assert (await shown(client, "Lot.Name")).StatusCode.value == ua.StatusCodes.BadNoData
        subscription = await client.create_subscription(50, heard)
        await subscription.subscribe_data_change(
            [await node_of(client, path) for path in ("Lot.Name", "Lot.Stones", "Lot.Verdict", "Figures.D50")]
        )
        served.plant.be(
            lot="L-1", product="p", n_stones=7, verdict=Verdict.CONFORMS, at="2026-11-28T06:10:00Z",
            d50_mm=Estimate(state=State.MEASURED, value=11.25, low=11.0, high=11.5),
            flakiness_percent=Estimate(state=State.INSUFFICIENT, value=8.0, low=1.0, high=30.0),
            shape_percent=Estimate(state=State.NOT_MEASURED), ne107=Ne107.OUT_OF_SPECIFICATION,
        )  # fmt: skip
        seen: dict[str, object] = {}
        while seen.get("VisionSystem.Figures.D50") != 11.25:
            path, value = await asyncio.wait_for(heard.values.get(), PATIENCE_S)
            seen[path] = value.Value.Value
        await soon(lambda: _is(client, "Lot.Name", "L-1"))
        d50 = await shown(client, "Figures.D50")
        assert d50.StatusCode.is_good()
        assert d50.SourceTimestamp.isoformat() == "2026-11-28T06:10:00+00:00"
        unit = await (await node_of(client, "Figures.D50.EngineeringUnits")).read_value()
        assert (unit.UnitId, unit.DisplayName.Text) == (5066068, "mm")
        few = await shown(client, "Figures.FI")
        assert few.StatusCode.value == ua.StatusCodes.UncertainSubNormal
        assert few.Value.Value == 8.0
        unmeasured = await shown(client, "Figures.SI")
        assert (unmeasured.StatusCode.value, unmeasured.Value.Value) == (ua.StatusCodes.BadNoData, None)
        for path, number in (("DeviceHealth", 3), ("Lot.Verdict", 3)):
            words = await (await node_of(client, f"{path}.EnumStrings")).read_value()
            assert (await shown(client, path)).Value.Value == number
            assert words[number].Text == {"DeviceHealth": "OFF_SPEC", "Lot.Verdict": "conforms"}[path]
        machine = "VisionStateMachine"
        assert (await shown(client, f"{machine}.CurrentState")).Value.Value.Text == "Operational"
        mode = f"{machine}.AutomaticModeStateMachine.CurrentState"
        assert (await shown(client, mode)).Value.Value.Text == "ContinuousExecution"
        state = client.get_node((await shown(client, f"{mode}.Id")).Value.Value)
        assert (await state.read_browse_name()).Name == "ContinuousExecution"
        served.plant.be(ne107=Ne107.FAILURE)
        await soon(lambda: _is(client, f"{machine}.CurrentState.Number", 3))
        assert (await shown(client, mode)).StatusCode.value == ua.StatusCodes.BadStateNotActive


async def test_each_result_is_one_event_and_the_cursor_follows(served: Served) -> None:
    heard = Heard()
    async with Client(served.url) as client:
        index = await client.get_namespace_index("urn:stonefall:opcua")
        subscription = await client.create_subscription(50, heard)
        kind = client.get_node(ua.NodeId("ResultReadyEventType", index))
        await subscription.subscribe_events(ua.ObjectIds.Server, [kind])
        served.plant.fall(
            result(4), result(5, outcome="lost", reason="queue_full", sieve_size_mm=None, lot=None)
        )
        first, second = [await asyncio.wait_for(heard.events.get(), PATIENCE_S) for _ in range(2)]
        assert (first.ResultId, first.seq, first.ResultState, first.JobId) == ("s-00000004", 4, 1, "L-1")
        assert (first.IsPartial, first.IsSimulated, first.HistoryId) == (False, True, "h-1")
        assert (first.sieve_size_mm, first.mass_g, first.revision) == (11.4, None, 1)
        assert json.loads(first.ResultContent) == result(4)
        assert first.CreationTime.isoformat() == "2026-11-28T06:00:01+00:00"
        assert (second.seq, second.ResultState, second.sieve_size_mm, second.lot) == (5, 3, None, None)
        await soon(lambda: _is(client, "ResultManagement.Cursor", 5))
        assert (await shown(client, "ResultManagement.HistoryId")).Value.Value == "h-1"
        latest = await shown(client, "ResultManagement.LatestResult.sieve_size_mm")
        assert (latest.StatusCode.value, latest.Value.Value) == (ua.StatusCodes.BadNoData, None)
        assert heard.events.empty()


async def test_missed_results_are_got_by_their_sequence_number(served: Served) -> None:
    served.plant.history = [result(seq) for seq in range(1, 251)]
    async with Client(served.url) as client:
        management = await node_of(client, "ResultManagement")
        method = await node_of(client, "ResultManagement.GetResults")
        answer = await management.call_method(
            method, ua.Variant(7, ua.VariantType.UInt64), ua.Variant(5000, ua.VariantType.UInt32)
        )
        history, first, last, items, error, problem = answer
        assert (history, first, last, error, problem) == ("h-1", 1, 250, 0, "")
        assert [json.loads(item) for item in items] == [result(seq) for seq in range(8, 108)]
        by_id = await node_of(client, "ResultManagement.GetResultById")
        handle, found, error, problem = await management.call_method(
            by_id, "s-00000008", ua.Variant(0, ua.VariantType.Int32)
        )
        assert (handle, json.loads(found), error, problem) == (0, result(8), 0, "")
        answer = await management.call_method(by_id, "none", ua.Variant(0, ua.VariantType.Int32))
        assert answer == [0, "", -1, "404 unknown-particle: there is none"]


async def test_an_alarm_is_a_condition_that_a_keyed_user_acknowledges(served: Served) -> None:
    served.plant.be(**_fields(replace(ARMED, alarms=(GATE,))))
    heard = Heard()
    async with served.operator() as client:
        await soon(lambda: _is(client, "Alarms.Active", 1))
        subscription = await client.create_subscription(50, heard)
        await subscription.subscribe_alarms_and_conditions(
            ua.ObjectIds.Server, ua.ObjectIds.AlarmConditionType
        )
        conditions = client.get_node(ua.ObjectIds.ConditionType)
        await conditions.call_method(
            "0:ConditionRefresh", ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
        )
        raised = await _condition(heard)
        assert (raised.ConditionName, raised.Severity, raised.Retain) == ("gate", 900, True)
        assert getattr(raised, "ActiveState/Id") and not getattr(raised, "AckedState/Id")
        assert raised.Message.Text == "the beam is closed"
        condition = client.get_node(raised.NodeId)
        acknowledge = ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Acknowledge)
        with pytest.raises(BadEventIdUnknown):
            await condition.call_method(acknowledge, b"another", ua.LocalizedText("seen"))
        served.plant.refusal = OrderRefusedError("409 alarm-conflict: it has ended", "alarm-conflict")
        with pytest.raises(UaError, match="BadConditionBranchAlreadyAcked"):
            await condition.call_method(acknowledge, raised.EventId, ua.LocalizedText("seen"))
        served.plant.refusal = None
        served.plant.orders.clear()
        await condition.call_method(acknowledge, raised.EventId, ua.LocalizedText("seen"))
        assert served.plant.orders == [("acknowledge 17", {}, "token-of-the-operator")]
        served.plant.be(alarms=(replace(GATE, state="acknowledged", acknowledged_by="op"),))
        seen = await _condition(heard)
        assert getattr(seen, "AckedState/Id") and seen.ClientUserId == "op" and seen.EventId != raised.EventId
        served.plant.be(daemon_answers=False, alarms=())
        assert (await _condition(heard)).Quality.value == ua.StatusCodes.BadNoCommunication
        served.plant.be(daemon_answers=True)
        ended = await _condition(heard)
        assert (ended.Retain, getattr(ended, "ActiveState/Id")) == (False, False)


async def test_lots_are_opened_with_the_key_of_the_user_or_refused_with_the_daemons_reason(
    served: Served,
) -> None:
    served.plant.orders.clear()
    async with served.operator() as client:
        lot, method = await node_of(client, "Lot"), await node_of(client, "Lot.OpenLot")
        assert await lot.call_method(method, "L-2", "p", "L-1", "") == [0, ""]
        assert served.plant.orders == [("open L-2 of p", {"closes": "L-1"}, "token-of-the-operator")]
        served.plant.refusal = OrderRefusedError("404 unknown-product: there is none", "unknown-product")
        assert await lot.call_method(method, "L-2", "q", "", "") == [-1, "404 unknown-product: there is none"]
        served.plant.refusal = None
        assert await lot.call_method(await node_of(client, "Lot.CloseLot"), "L-2") == [0, ""]
        for wrong in (["L"], ["L", "p", "", "", ""], ["L", "p", "", 5]):
            with pytest.raises(UaError):
                await lot.call_method(method, *wrong)
    async with served.operator("deputy") as client:
        closed = await (await node_of(client, "Lot")).call_method(
            await node_of(client, "Lot.CloseLot"), "L-3"
        )
        assert (closed, served.plant.orders[-1]) == ([0, ""], ("close L-3", {}, None))
    async with served.operator("reader") as client:
        with pytest.raises(BadUserAccessDenied):
            await (await node_of(client, "Lot")).call_method(await node_of(client, "Lot.CloseLot"), "L-2")
    async with Client(served.url) as client:
        with pytest.raises(BadUserAccessDenied):
            await (await node_of(client, "Lot")).call_method(await node_of(client, "Lot.CloseLot"), "L-2")
        with pytest.raises(BadMethodInvalid):
            await client.get_node(ua.ObjectIds.Server).call_method(
                ua.NodeId(ua.ObjectIds.Server_GetMonitoredItems), 1
            )


async def test_a_user_may_sign_in_with_a_certificate(served: Served) -> None:
    client = await secured(served.url, served.client)
    await client.load_client_certificate(str(served.client.certificate))
    await client.load_private_key(str(served.client.key))
    async with client:
        assert await (await node_of(client, "Lot")).call_method(
            await node_of(client, "Lot.CloseLot"), "L-9"
        ) == [0, ""]


@pytest.mark.parametrize("mode", [ua.MessageSecurityMode.Sign, ua.MessageSecurityMode.SignAndEncrypt])
async def test_an_untrusted_certificate_is_refused_kept_and_told_until_it_is_moved(
    served: Served, caplog: pytest.LogCaptureFixture, mode: ua.MessageSecurityMode
) -> None:
    rejected = served.folder / "rejected" / f"{thumbprint(served.stranger.der)}.der"
    with caplog.at_level(logging.WARNING), pytest.raises((UaError, ConnectionError)):
        await (await secured(served.url, served.stranger, mode=mode)).connect()
    assert rejected.read_bytes() == served.stranger.der
    assert any(thumbprint(served.stranger.der) in line and "not trusted" in line for line in caplog.messages)
    moved = rejected.rename(served.folder / "trusted" / rejected.name)
    async with await secured(served.url, served.stranger, ("reader", "right"), mode) as client:
        assert (await shown(client, "DaemonAnswers")).Value.Value is not None
    moved.unlink()


async def test_wrong_passwords_are_refused_slowed_down_and_told(
    served: Served, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        for name, word in (("operator", "wrong"), ("nobody", "right"), ("line", "right")):
            with pytest.raises(BadUserAccessDenied):
                await (await secured(served.url, served.client, (name, word))).connect()
    assert sum("refused: 127.0.0.1" in line for line in caplog.messages) == 3
    for _ in range(9):
        served.outlet.access.note_wrong(("127.0.0.1", "operator"))
    with pytest.raises(BadUserAccessDenied):  # it is the eleventh attempt of this minute
        await (await secured(served.url, served.client, ("operator", "right"))).connect()
    async with served.operator("deputy"):
        pass  # another user is not slowed down


async def test_passwords_are_not_taken_over_an_open_channel(served: Served) -> None:
    client = Client(served.url)
    client.set_user("operator")
    client.set_password("right")
    with pytest.raises(UaError):
        await client.connect()


async def test_anonymous_readers_come_from_this_machine_only(
    served: Served, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(sessions, "is_loopback", lambda _: False)
    with caplog.at_level(logging.WARNING):
        for client in (Client(served.url), await secured(served.url, served.client)):
            with pytest.raises(BadIdentityTokenRejected):
                await client.connect()
    assert any("anonymous, and not of this machine" in line for line in caplog.messages)


async def test_nobody_writes_to_nodes_or_changes_the_address_space(served: Served) -> None:
    async with served.operator() as client:
        for path in ("Lot.Name", "Ready", "Figures.D50.EngineeringUnits"):
            with pytest.raises(BadNotWritable):
                await (await node_of(client, path)).write_value("x")
        with pytest.raises(BadNotWritable):
            await client.get_node(ua.ObjectIds.Server_ServerStatus_CurrentTime).write_value(now_utc())
        with pytest.raises(UaError):
            await (await node_of(client, "")).add_object(2, "mine")
        with pytest.raises(UaError):
            await client.delete_nodes([await node_of(client, "Lot")])


async def test_a_subscription_is_its_sessions_own(served: Served) -> None:
    async with Client(served.url) as one, Client(served.url) as other:
        subscription = await one.create_subscription(100, Heard())
        number = subscription.subscription_id
        with pytest.raises(BadSubscriptionIdInvalid):
            await other.uaclient.delete_subscriptions([number])
        refresh = ua.Variant(number, ua.VariantType.UInt32)
        with pytest.raises(BadSubscriptionIdInvalid):
            await other.get_node(ua.ObjectIds.ConditionType).call_method("0:ConditionRefresh", refresh)
        taken = ua.TransferSubscriptionsParameters(SubscriptionIds=[number], SendInitialValues=True)
        with pytest.raises(UaError):
            await other.uaclient.transfer_subscriptions(taken)
        assert await one.uaclient.delete_subscriptions([number])


async def test_periods_and_numbers_are_bounded(served: Served) -> None:
    async with Client(served.url) as client:
        for asked in (0.0, 0.001, -5.0, math.nan, math.inf):
            params = ua.CreateSubscriptionParameters(
                RequestedPublishingInterval=asked, RequestedLifetimeCount=10, RequestedMaxKeepAliveCount=5
            )
            revised = await client.uaclient.create_subscription(params, lambda _: None)
            assert 50 <= revised.RevisedPublishingInterval <= 60_000
        for _ in range(sessions.MAX_SUBSCRIPTIONS_OF_SESSION - 5):
            await client.create_subscription(1000, Heard())
        with pytest.raises(UaError):
            await client.create_subscription(1000, Heard())
        with pytest.raises(UaError):
            await client.read_values([await node_of(client, "Ready")] * 1001)
        with pytest.raises(UaError):
            await client.read_values([client.get_node(ua.ObjectIds.OpcUa_BinarySchema)] * 3)
        limits = client.get_node(ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead)
        assert await limits.read_value() == 1000


async def test_a_filter_that_would_fail_later_is_refused(served: Served) -> None:
    select = ua.SimpleAttributeOperand(
        BrowsePath=[ua.QualifiedName("data_types")], AttributeId=ua.AttributeIds.Value
    )
    twice = [ua.ElementOperand(Index=place) for place in (1, 1)]
    never_ending = ua.ContentFilter(
        Elements=[ua.ContentFilterElement(ua.FilterOperator.And, twice) for _ in range(40)]
    )
    async with Client(served.url) as client:
        subscription = await client.create_subscription(100, Heard())
        for wrong in (ua.EventFilter(SelectClauses=[select]), ua.EventFilter(WhereClause=never_ending)):
            with pytest.raises(UaError):
                await subscription.subscribe_events(evfilter=wrong)
        with pytest.raises(UaError):
            await subscription.deadband_monitor(await node_of(client, "Trouble"), 1.0)


async def test_a_slow_client_has_a_bounded_queue_and_gets_the_newest(served: Served) -> None:
    heard = Heard()
    async with Client(served.url) as client:
        params = ua.CreateSubscriptionParameters(
            RequestedPublishingInterval=60_000, RequestedLifetimeCount=100, RequestedMaxKeepAliveCount=10
        )
        subscription = Subscription(client.uaclient, params, heard)
        await subscription.init()
        kind = client.get_node(ua.NodeId("ResultReadyEventType", INDEX))
        await subscription.subscribe_events(evtypes=kind)
        for _ in range(sessions.MAX_EVENT_ITEMS_OF_SESSION - 1):
            await subscription.subscribe_events(evtypes=kind)
        with pytest.raises(UaError):
            await subscription.subscribe_events(evtypes=kind)
        for seq in range(1, sessions.MAX_QUEUE + 301):
            served.plant.fall(result(seq))
        await soon(lambda: _is(client, "ResultManagement.Cursor", sessions.MAX_QUEUE + 300))
        service = served.outlet.server.iserver.subscription_service
        queued = service.subscriptions[subscription.subscription_id]._triggered_events
        assert {len(events) for events in queued.values()} <= {sessions.MAX_QUEUE}
        oldest = next(iter(queued.values()))[0].EventFields
        assert 301 in [field.Value for field in oldest]


async def test_a_client_that_reads_no_answers_is_disconnected(
    served: Served, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    served.outlet.access._told.clear()
    monkeypatch.setattr(connections, "MAX_UNREAD_BYTES", 200_000)
    # its own watchdog would find that no answer comes, and ask no more
    client = Client(served.url, timeout=PATIENCE_S, watchdog_intervall=10 * PATIENCE_S)
    await client.connect()
    clients = served.outlet.server.bserver.clients
    ours = clients[-1]
    nodes = [client.get_node(ua.ObjectIds.Server_ServerStatus)] * 1000
    asking: set[asyncio.Task[object]] = set()
    async with asyncio.timeout(PATIENCE_S):
        await client.read_values(nodes)
        assert ours in clients, "who reads stays"
        client.uaclient.protocol.transport.pause_reading()
        while ours in clients:
            if ours.messages.empty():  # too many at once are refused for themselves
                asking.add(asyncio.create_task(client.read_values(nodes)))
            await asyncio.sleep(0.02)
    assert "127.0.0.1 reads no answers: its connection is closed" in caplog.text
    client.uaclient.protocol.transport.resume_reading()
    for task in asking:
        task.cancel()
    await asyncio.gather(*asking, return_exceptions=True)
    with suppress(Exception):
        await client.disconnect()


async def test_more_connections_than_are_allowed_cost_those_that_may_not_read(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(served.outlet.server.iserver, "max_connections", 3)
    idle = [await asyncio.open_connection("127.0.0.1", served.outlet.port) for _ in range(5)]
    async with Client(served.url) as client:
        assert (await shown(client, "DaemonAnswers")).StatusCode.is_good()
        assert await asyncio.wait_for(idle[0][0].read(), PATIENCE_S) == b""
    for _, writer in idle:
        writer.close()


async def test_a_connection_makes_few_sessions(served: Served) -> None:
    client = Client(served.url)
    await client.connect_sessionless()
    with pytest.raises(BadTooManySessions):
        for _ in range(sessions.MAX_SESSIONS_OF_CONNECTION + 1):
            await client.create_session()
    await client.disconnect_sessionless()


async def test_the_bytes_of_strangers_close_their_own_connection_only(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(served.outlet.server.iserver, "max_pending_activation_seconds", 0.5)
    host, port = "127.0.0.1", served.outlet.port
    for sent in (
        b"GET / HTTP/1.1\r\n\r\n" * 10, b"HELF" + b"\xff" * 60, b"MSGF\xff\xff\xff\x7f" + bytes(100_000),
        b"HELF\x20\x00\x00\x00" + bytes(4) + b"\x01\x00\x00\x00" * 2 + bytes(12),
        b"MSGF\x40\x00\x00\x00" + bytes(56), b"OPNF\x20\x00\x00\x00" + bytes(24),
    ):  # fmt: skip
        reader, writer = await asyncio.open_connection(host, port)
        writer.write(sent)
        await asyncio.wait_for(reader.read(), PATIENCE_S)  # until the server closes it
        writer.close()
    async with Client(served.url) as client:
        assert (await shown(client, "DaemonAnswers")).StatusCode.is_good()


async def test_the_clients_of_the_guide_see_each_stone_once(served: Served, tmp_path: Path) -> None:
    (snippet,) = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    program = tmp_path / "follow.py"
    program.write_text(snippet)
    served.plant.history = [result(seq) for seq in range(1, 211)]
    arguments = (sys.executable, program, served.url, "7")
    process = await asyncio.create_subprocess_exec(*arguments, stdout=asyncio.subprocess.PIPE)
    assert process.stdout is not None
    try:
        for seq in range(8, 251):
            if seq in (211, 240):
                served.plant.fall(*(result(each) for each in range(seq, 240 if seq == 211 else 251)))
            line = await asyncio.wait_for(process.stdout.readline(), PATIENCE_S)
            assert line.decode() == f"{seq} measured 11.4\n"
    finally:
        process.kill()
        await process.wait()


async def test_the_table_of_the_guide_is_that_of_the_server(served: Served) -> None:
    rows = []
    for each in (*SHOWN, *POSITION):
        kind = ua.ObjectIdNames[each.data_type] + ("[]" if each.is_list else "")
        words = ", ".join(f"{number} {word}" for number, word in enumerate(each.words))
        rows.append(
            f"| `{each.path}` | {kind} | {'' if each.unit is None else UNITS[each.unit][1]}{words} | {each.meaning} |"
        )
    rows.append(
        "| `ResultManagement.LatestResult.NAME` | | | Each field of the newest result, by its name in REST |"
    )
    async with Client(served.url) as client:
        for method in (
            "Lot.OpenLot",
            "Lot.CloseLot",
            "ResultManagement.GetResultById",
            "ResultManagement.GetResults",
        ):
            node = await node_of(client, method)
            given, answered = [
                ", ".join(each.Name for each in await (await node.get_child(f"0:{name}")).read_value())
                for name in ("InputArguments", "OutputArguments")
            ]
            meaning = (await node.read_description()).Text
            rows.append(f"| `{method}({given})` | method | | {meaning}. It answers {answered} |")
        browsed = [path async for path in _variables(await node_of(client, ""))]
    assert sorted(browsed) == sorted(each.path for each in (*SHOWN, *POSITION, *latest()))
    table = GUIDE.read_text().split("| node | type |")[1].split("\n\n")[0].splitlines()[2:]
    assert table == rows, "\n".join(rows)


async def test_a_session_is_not_taken_over_by_its_number(served: Served) -> None:
    async with served.operator() as operator:
        token = operator.uaclient.protocol.authentication_token
        thief = Client(served.url)
        await thief.connect_sessionless()
        thief.uaclient.protocol.authentication_token = token
        with pytest.raises(BadSessionIdInvalid):
            await thief.activate_session()
        with pytest.raises((UaError, ConnectionError)):
            await (await node_of(thief, "Lot")).call_method(await node_of(thief, "Lot.CloseLot"), "L-2")
        await thief.disconnect_sessionless()


async def _variables(node: Any) -> AsyncIterator[str]:
    """Yield the paths of all variables below a node that are of the plant, not of OPC UA."""
    for child in await node.get_children():
        path = str(child.nodeid.Identifier).removeprefix("VisionSystem.")
        name, kind = await child.read_browse_name(), await child.read_node_class()
        if kind is ua.NodeClass.Variable and (
            name.NamespaceIndex or name.Name in ("CurrentState", "Id", "Number")
        ):
            yield path
        if kind in (ua.NodeClass.Object, ua.NodeClass.Variable):
            async for below in _variables(child):
                yield below


async def _is(client: Client, path: str, value: object) -> bool:
    found = (await shown(client, path)).Value
    return found is not None and found.Value == value


def _fields(state: object) -> dict[str, object]:
    return {name: getattr(state, name) for name in type(state).__dataclass_fields__}  # type: ignore[attr-defined]


async def _condition(heard: Heard) -> object:
    """Return the next event of a condition."""
    while True:
        event = await asyncio.wait_for(heard.events.get(), PATIENCE_S)
        if getattr(event, "ConditionName", None):
            return event
