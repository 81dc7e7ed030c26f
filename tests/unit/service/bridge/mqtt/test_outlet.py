"""Both forms of MQTT at a real broker: nothing lost, nothing out of order, retained state, wills, commands."""

import asyncio
import json
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from gate.steps import Extent
from support.eventually import soon
from support.extents import extent_of
from support.mosquitto import Mosquitto, Subscriber, publish
from support.plants import ANSWERS, FakePlant, result
from support.wire import fields_of

from service.bridge.mqtt import connection, edge_node, link
from service.bridge.mqtt.outlet import run
from service.bridge.mqtt.settings import MqttSettings, SparkplugSettings
from service.bridge.mqtt.sparkplug import METRICS
from service.bridge.plant_state import PlantAlarm, PlantState

JSON = "stonefall/line-1"
SPARKPLUG = SparkplugSettings(group="plant", node="crusher", device="rig")
HOSTED = replace(SPARKPLUG, primary_host="scada")
NCMD, DDATA = "spBv1.0/plant/NCMD/crusher", "spBv1.0/plant/DDATA/crusher/rig"
NBIRTH, NDEATH = "spBv1.0/plant/NBIRTH/crusher", "spBv1.0/plant/NDEATH/crusher"
STATE = "spBv1.0/STATE/scada"
REBIRTH = bytes.fromhex("12180a144e6f646520436f6e74726f6c2f526562697274687001")
ALARM = PlantAlarm(
    id=3, check="gate", priority="high", state="unacknowledged", detail="dark", raised_at="2026-08-15T09:00:00Z",
    acknowledged_by=None, cause="c", action="a",
)  # fmt: skip


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have pauses that a test can wait for."""
    monkeypatch.setattr(link, "FIRST_PAUSE_S", 0.05)
    monkeypatch.setattr(link, "LONGEST_PAUSE_S", 0.2)


def settings(port: int, sparkplug: SparkplugSettings | None = None, **more: Any) -> MqttSettings:
    words: dict[str, Any] = {"host": "127.0.0.1", "tls": False, "prefix": None if sparkplug else JSON}
    return MqttSettings(**{**words, "port": port, "sparkplug": sparkplug, **more})


@asynccontextmanager
async def running(wanted: MqttSettings, plant: FakePlant) -> AsyncIterator[None]:
    task = asyncio.create_task(run(wanted, plant))
    try:
        yield
        assert not task.done(), task.exception()
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


def seqs(subscriber: Subscriber) -> list[int]:
    """Return the numbers of the results that came, in their order."""
    return [each.document["seq"] for each in subscriber.of(f"{JSON}/results")]


def told_seqs(subscriber: Subscriber) -> list[tuple[int, bool]]:
    """Return the same of Sparkplug, and which were historical."""
    found = []
    for each in subscriber.of(DDATA):
        metrics = [dict(fields_of(value)) for number, value in fields_of(each.payload) if number == 2]
        found += [
            (metric[11], 5 in metric) for metric in metrics if metric.get(2) == METRICS["result/seq"].alias
        ]
    return found


def bd_seq(payload: bytes) -> int:
    metric = dict(fields_of(next(value for number, value in fields_of(payload) if number == 2)))
    assert metric[1] == b"bdSeq"
    return int(metric[11])


async def test_each_result_comes_once_in_order_and_the_state_is_retained(tmp_path: Path) -> None:
    plant = FakePlant(tmp_path, replace(ANSWERS, lot="L/#+", alarms=(ALARM,)))
    plant.fall(*(result(seq) for seq in range(1, 101)))
    with Mosquitto(tmp_path / "broker") as broker, Subscriber(broker, f"{JSON}/#") as there:
        async with running(settings(broker.port), plant):
            await soon(lambda: len(seqs(there)) >= 100)
            plant.fall(result(101))
            await soon(lambda: len(seqs(there)) >= 101)
            assert seqs(there) == list(range(1, 102))
            assert not any(each.is_retained for each in there.of(f"{JSON}/results"))
            with Subscriber(broker, f"{JSON}/#") as later:
                await soon(lambda: len(later.heard) >= 6)
                assert {each.topic.removeprefix(f"{JSON}/") for each in later.heard} == {
                    "status", "state", "health", "lot", "verdict", "alarms/gate",
                }  # fmt: skip
                assert all(each.is_retained for each in later.heard)
                assert later.newest(f"{JSON}/lot")["lot"] == "L/#+"
                assert later.newest(f"{JSON}/status") == {"status": "online"}
                assert later.newest(f"{JSON}/alarms/gate")["state"] == "unacknowledged"
                plant.show(
                    replace(ANSWERS, alarms=(replace(ALARM, state="acknowledged", acknowledged_by="mes"),))
                )
                await soon(lambda: later.newest(f"{JSON}/alarms/gate")["acknowledged_by"] == "mes")
                plant.show(ANSWERS)
                await soon(lambda: later.newest(f"{JSON}/alarms/gate")["state"] == "normal")
                plant.show(PlantState(trouble="no answer"))
                await soon(lambda: later.newest(f"{JSON}/state")["trouble"] == "no answer")
                await soon(lambda: later.newest(f"{JSON}/health")["ready"] is None)
        await soon(lambda: there.newest(f"{JSON}/status") == {"status": "offline"})


async def test_an_alarm_that_ends_while_no_bridge_runs_is_normal_with_the_next(tmp_path: Path) -> None:
    plant = FakePlant(tmp_path, replace(ANSWERS, alarms=(ALARM,)))
    with Mosquitto(tmp_path / "broker") as broker, Subscriber(broker, f"{JSON}/#") as there:
        async with running(settings(broker.port), plant):
            await soon(lambda: there.newest(f"{JSON}/alarms/gate") is not None)
        async with running(settings(broker.port), FakePlant(tmp_path)):
            await soon(lambda: there.newest(f"{JSON}/alarms/gate")["state"] == "normal")


async def test_results_wait_for_a_subscriber(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    plant = FakePlant(tmp_path)
    plant.fall(*(result(seq) for seq in range(1, 51)))
    with Mosquitto(tmp_path / "broker") as broker:
        async with running(settings(broker.port), plant):
            await soon(lambda: "nothing subscribes to stonefall/line-1/results" in caplog.text)
            assert not (tmp_path / "mqtt" / "results.cursor").exists()
            with Subscriber(broker, f"{JSON}/results") as there:
                await soon(lambda: len(seqs(there)) >= 50)
                assert seqs(there) == list(range(1, 51))
        async with running(settings(broker.port, waits_for_subscriber=False), plant):
            plant.fall(result(51))
            await soon(lambda: cursor(tmp_path) == 51)


def cursor(folder: Path) -> int:
    file = folder / "mqtt" / "results.cursor"
    return int(json.loads(file.read_text())["after"]) if file.exists() else 0


async def test_a_broker_that_is_away_costs_no_result(tmp_path: Path) -> None:
    plant = FakePlant(tmp_path)
    with Mosquitto(tmp_path / "broker") as broker, Subscriber(broker, f"{JSON}/#", DDATA) as there:
        async with running(settings(broker.port, SPARKPLUG, prefix=JSON), plant):
            plant.fall(result(1, recorded_at="2026-08-15T10:00:01Z"))
            await soon(lambda: len(seqs(there)) == 1 and len(told_seqs(there)) == 1)
            broker.kill()
            plant.fall(*(result(seq, recorded_at="2026-08-15T10:00:02Z") for seq in range(2, 101)))
            plant.show(replace(ANSWERS, at="2026-08-15T10:00:03Z", lot="L-2"))
            broker.start()
            await soon(lambda: seqs(there)[-1:] == [100])
            await soon(lambda: there.newest(f"{JSON}/lot")["lot"] == "L-2")
            assert [seq for seq in seqs(there) if seq != 1] == list(range(2, 101))  # the first may come again


async def test_what_a_broker_forgot_comes_again(tmp_path: Path) -> None:
    plant = FakePlant(tmp_path)
    with Mosquitto(tmp_path / "broker") as broker, Subscriber(broker, f"{JSON}/results") as there:
        async with running(settings(broker.port), plant):
            there.pause(is_paused=True)
            plant.fall(*(result(seq) for seq in range(1, 101)))
            await soon(lambda: cursor(tmp_path) == 100)  # acknowledged, and in the broker's memory alone
            broker.kill()
            broker.start()
            there.pause(is_paused=False)
            await soon(lambda: set(seqs(there)) == set(range(1, 101)))


async def test_a_broker_that_was_only_out_of_reach_is_told_nothing_twice(tmp_path: Path) -> None:
    plant = FakePlant(tmp_path)
    with Mosquitto(tmp_path / "broker") as broker, Subscriber(broker, f"{JSON}/#") as there:
        async with running(settings(broker.port), plant):
            plant.fall(result(1))
            await soon(lambda: seqs(there) == [1])
            with Subscriber(broker, f"{JSON}/#", client_id="stonefall"):  # takes the connection over
                await soon(lambda: len(there.of(f"{JSON}/status")) >= 2)
            plant.fall(result(2))
            await soon(lambda: seqs(there)[-1:] == [2])
            assert seqs(there) == [1, 2]


async def test_what_sparkplug_held_back_is_historical(tmp_path: Path) -> None:
    plant = FakePlant(tmp_path)
    with Mosquitto(tmp_path / "broker") as broker:
        publish(broker.port, STATE, b'{"online": true, "timestamp": 1000}', is_retained=True)
        with Subscriber(broker, "spBv1.0/#") as there:
            async with running(settings(broker.port, HOSTED), plant):
                await soon(lambda: len(there.of(NBIRTH)) == 1)
                plant.fall(result(1, recorded_at="2026-08-15T10:00:01Z"))
                await soon(lambda: told_seqs(there) == [(1, False)])
                publish(
                    broker.port, STATE, b'{"online": false, "timestamp": 999}', is_retained=True
                )  # an old death
                publish(broker.port, STATE, b'{"online": false, "timestamp": 1000}', is_retained=True)
                await soon(lambda: len(there.of(NDEATH)) == 1)
                plant.fall(*(result(seq, recorded_at="2026-08-15T10:00:02Z") for seq in range(2, 101)))
                plant.show(replace(ANSWERS, at="2026-08-15T10:00:03Z"))
                await asyncio.sleep(0.5)
                assert (len(there.of(NBIRTH)), len(told_seqs(there))) == (1, 1)
                publish(broker.port, STATE, b'{"online": true, "timestamp": 2000}', is_retained=True)
                await soon(lambda: len(told_seqs(there)) == 100)
                assert told_seqs(there)[1:] == [(seq, True) for seq in range(2, 101)]
                plant.fall(result(101, recorded_at="2026-08-15T10:00:04Z"))
                await soon(lambda: told_seqs(there)[-1] == (101, False))
                births, deaths = (
                    [bd_seq(each.payload) for each in there.of(topic)] for topic in (NBIRTH, NDEATH)
                )
                assert deaths[0] == births[0]
                assert births[0] != births[1]
            await soon(lambda: there.of(NDEATH)[-1:] and bd_seq(there.of(NDEATH)[-1].payload) == births[-1])


async def test_the_number_of_births_goes_on_after_a_restart(tmp_path: Path) -> None:
    (tmp_path / "sparkplug").mkdir()
    (tmp_path / "sparkplug" / "bdseq").write_text("254")
    with Mosquitto(tmp_path / "broker") as broker, Subscriber(broker, "spBv1.0/#") as there:
        for expected in (255, 0, 1):
            async with running(settings(broker.port, SPARKPLUG), FakePlant(tmp_path)):
                await soon(lambda: bool(there.of(NBIRTH)))
                assert bd_seq(there.of(NBIRTH)[-1].payload) == expected
            await soon(lambda: bool(there.of(NDEATH)))
            assert bd_seq(there.of(NDEATH)[-1].payload) == expected
            there.heard.clear()


async def test_a_rebirth_is_obeyed_and_hostile_commands_are_told_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(edge_node, "REBIRTH_EVERY_S", 0.0)
    plant = FakePlant(tmp_path)
    with Mosquitto(tmp_path / "broker") as broker, Subscriber(broker, "spBv1.0/#") as there:
        async with running(settings(broker.port, SPARKPLUG), plant):
            await soon(lambda: len(there.of(NBIRTH)) == 1)
            for payload in (
                b"\xff" * 100,
                b"x" * 60_000,
                b"\x12\xff\xff\xff\xff\x0f",
                b'{"Rebirth": true}',
            ):
                publish(broker.port, NCMD, payload)
            publish(broker.port, f"{NCMD}/more", REBIRTH)
            publish(broker.port, "spBv1.0/plant/DCMD/crusher/rig", REBIRTH)
            publish(broker.port, NCMD, REBIRTH)
            await soon(lambda: len(there.of(NBIRTH)) == 2)
            assert there.of(NBIRTH)[0].payload[-2:] == there.of(NBIRTH)[1].payload[-2:] == b"\x18\x00"
            plant.fall(result(1))
            await soon(lambda: len(told_seqs(there)) == 1)
            messages = [
                each for each in there.heard if each.topic.split("/")[2] in ("NBIRTH", "DBIRTH", "DDATA")
            ]
            numbers = [dict(fields_of(each.payload))[3] for each in messages]
            assert all(
                b == (0 if "NBIRTH" in m.topic else a + 1)
                for (a, b), m in zip(pairwise(numbers), messages[1:], strict=True)
            )
    assert caplog.text.count("ignored, as it is no Sparkplug B payload") == 1


async def test_a_flood_of_rebirths_has_one_birth_in_a_second(tmp_path: Path) -> None:
    with Mosquitto(tmp_path / "broker") as broker, Subscriber(broker, "spBv1.0/#") as there:
        async with running(settings(broker.port, SPARKPLUG), FakePlant(tmp_path)):
            await soon(lambda: len(there.of(NBIRTH)) == 1)
            began_s = asyncio.get_running_loop().time()
            for _ in range(20):
                publish(broker.port, NCMD, REBIRTH)
            await soon(lambda: len([each for each in there.heard if each.topic == NCMD]) == 20)
            await soon(lambda: len(there.of(NBIRTH)) >= 2)
            passed_s = asyncio.get_running_loop().time() - began_s
            assert len(there.of(NBIRTH)) <= 2 + passed_s / edge_node.REBIRTH_EVERY_S


async def test_a_refusal_of_the_broker_is_told_once_and_loses_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    acl = tmp_path / "acl"
    acl.write_text(f"topic write {JSON}/status\ntopic read #\n")
    plant = FakePlant(tmp_path)
    plant.fall(result(1))
    more = f"allow_anonymous true\nacl_file {acl}"
    with Mosquitto(tmp_path / "broker", more) as broker, Subscriber(broker, "#") as there:
        async with running(settings(broker.port), plant):
            await soon(lambda: "it refuses stonefall/line-1/" in caplog.text)
            await soon(
                lambda: len([each for each in there.heard if each.document == {"status": "online"}]) > 3
            )
            assert caplog.text.count("it refuses") == 1
            assert not (tmp_path / "mqtt" / "results.cursor").exists()
            assert seqs(there) == []


async def test_a_broker_that_hangs_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "ACKNOWLEDGED_S", 0.5)
    monkeypatch.setattr(connection, "CONNECT_S", 2.0)
    monkeypatch.setattr(connection, "CLOSE_S", 0.2)
    plant = FakePlant(tmp_path)
    with Mosquitto(tmp_path / "broker") as broker, Subscriber(broker, f"{JSON}/#") as there:
        async with running(settings(broker.port), plant):
            plant.fall(result(1))
            await soon(lambda: seqs(there) == [1])
            broker.pause(is_paused=True)
            plant.fall(*(result(seq) for seq in range(2, 31)))
            await asyncio.sleep(1.5)
            broker.pause(is_paused=False)
            await soon(lambda: set(seqs(there)) == set(range(1, 31)))


async def test_what_is_left_while_it_connects_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    began, goes_on, connect = threading.Event(), threading.Event(), connection.Client.connect
    connecting: list[threading.Thread] = []

    def slow(client: connection.Client, *words: Any, **more: Any) -> Any:
        done = connect(client, *words, **more)
        connecting.append(threading.current_thread())
        began.set()
        goes_on.wait()
        return done

    monkeypatch.setattr(connection.Client, "connect", slow)
    with Mosquitto(tmp_path / "broker") as broker:
        async with running(settings(broker.port), FakePlant(tmp_path)):
            await soon(began.is_set)
        goes_on.set()
        await soon(lambda: not connecting[0].is_alive())
        assert not [thread for thread in threading.enumerate() if thread.name.startswith("paho-mqtt")]


async def test_kills_of_the_broker_lose_no_result(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    n_kills = {Extent.QUICK: 2, Extent.FULL: 5, Extent.NIGHT: 50}[extent_of(request.config)]
    plant = FakePlant(tmp_path)
    with Mosquitto(tmp_path / "broker") as broker, Subscriber(broker, f"{JSON}/results") as there:
        async with running(settings(broker.port), plant):
            for n_killed in range(n_kills):
                fallen = [result(100 * n_killed + each) for each in range(1, 101)]
                plant.fall(*fallen)
                await soon(partial(is_past, there, fallen[40]["seq"]))  # some, in the middle of the flow
                broker.kill()
                broker.start()
            await soon(lambda: set(seqs(there)) == set(range(1, 100 * n_kills + 1)))


def is_past(subscriber: Subscriber, seq: int) -> bool:
    return seq in seqs(subscriber)
