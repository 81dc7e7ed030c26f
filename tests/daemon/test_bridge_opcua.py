"""Foreign clients of OPC UA at a real daemon: asyncua's commands as processes, and its client, through kills."""

import asyncio
import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from asyncua import Client, ua
from support.daemon_process import DaemonProcess, free_port
from support.eventually import PATIENCE_S, eventually, soon
from support.opcua import Heard, Identity, make_identity, node_of, secured
from support.reference_client import client as reference
from support.small_recording import write_small_recording
from support.warm_stonefall import WarmStonefall

from service.bridge.opcua.passwords import hash_password

RIG = "loop = true\nspeed = 2.5"  # ten stones a second
KEYS = {"admin": ("read", "operate", "configure"), "bridge": ("read",), "anna": ("operate",)}
GUIDE = Path("service/bridge/README.md")


def rig_with_keys(folder: Path) -> str:
    """Return the rig's settings with keys, whose tokens lie in the folder."""
    text = f"{RIG}\n"
    for name, scopes in KEYS.items():
        token = f"token-of-{name}"
        (folder / f"{name}.key").write_text(token)
        digest = sha256(token.encode()).hexdigest()
        text += f'[[api.keys]]\nname = "{name}"\nsha256 = "{digest}"\nscopes = {json.dumps(scopes)}\n'
    return text


class Bridge:
    """The bridge as a process, which can be killed and started."""

    def __init__(self, folder: Path, daemon_port: int) -> None:
        self.folder, self.port = folder, free_port()
        self.url = f"opc.tcp://127.0.0.1:{self.port}"
        users = [{"name": "anna", "password": hash_password("word"), "key_file": "anna.key"}]
        daemon = {"url": f"http://127.0.0.1:{daemon_port}", "key_file": "bridge.key"}
        config = {"dir": "bridge", "daemon": daemon, "opcua": {"port": self.port, "users": users}}
        (folder / "bridge.toml").write_text(tomli_w.dumps(config))
        self.log = folder / "bridge.log"
        self.log.touch()
        self.n_starts = 0

    def start(self) -> None:
        self.process = WarmStonefall(
            ("bridge", "--config", self.folder / "bridge.toml"), out=self.folder / "bridge.out", log=self.log
        )
        self.n_starts += 1
        eventually(lambda: self.log.read_text().count("opc.tcp://127.0.0.1") >= self.n_starts)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


@contextmanager
def plant(folder: Path) -> Iterator[tuple[DaemonProcess, Bridge, Identity]]:
    """Run a daemon with keys, and the bridge, which trusts a client."""
    write_small_recording(folder / "recording", n_stones=8)
    port = free_port()
    client = make_identity(folder, "client")
    trusted = folder / "bridge" / "opcua" / "trusted"
    trusted.mkdir(parents=True)
    (trusted / "client.der").write_bytes(client.der)
    bridge = Bridge(folder, port)
    daemon = DaemonProcess(folder, folder / "recording", rig=rig_with_keys(folder), slots=2, port=port)
    with daemon:
        daemon.hear("READY=1")
        bridge.start()
        try:
            yield daemon, bridge, client
        finally:
            bridge.kill()
    assert "Traceback" not in bridge.log.read_text()


def asked(folder: Path, daemon: DaemonProcess, method: str, path: str, body: Any = None) -> dict[str, Any]:
    """Return the answer to who has all rights."""
    admin = reference.Client(daemon.url("").removesuffix("/api/v1"), folder / "admin.key")
    try:
        return dict(admin.ask(method, path, body))
    finally:
        admin.close()


def told(command: str, *arguments: str) -> str:
    """Return the output of one of asyncua's commands."""
    program = Path(sys.executable).with_name(command)
    found = subprocess.run(
        [program, "--timeout", "60", *arguments], capture_output=True, text=True, timeout=PATIENCE_S
    )
    return found.stdout + found.stderr


@pytest.mark.full
@pytest.mark.timeout(900)
async def test_foreign_clients_see_a_lot_stones_a_verdict_an_alarm_and_the_end_of_the_daemon(
    tmp_path: Path,
) -> None:
    with plant(tmp_path) as (daemon, bridge, identity):
        product = {"title": "basalt", "density_kg_m3": 2700, "lower_mm": 16, "upper_mm": 31.5}
        asked(tmp_path, daemon, "PUT", "/products/basalt", {**product, "specification": "GC85-20"})
        heard = Heard()
        async with await secured(bridge.url, identity, ("anna", "word")) as client:
            await soon(lambda: _is(client, "DaemonAnswers", True))
            subscription = await client.create_subscription(100, heard)
            await subscription.subscribe_alarms_and_conditions(
                ua.ObjectIds.Server, ua.ObjectIds.AlarmConditionType
            )
            lot = await node_of(client, "Lot")
            method = await node_of(client, "Lot.OpenLot")
            refused = await lot.call_method(method, "L-7", "nothing", "", "")
            assert refused[0] == -1
            assert "unknown-product" in refused[1]
            assert await lot.call_method(method, "L-7", "basalt", "", "") == [0, ""]
            await soon(lambda: _is(client, "Lot.Name", "L-7"))
            assert told("uaread", "-u", bridge.url, "-n", "ns=2;s=VisionSystem.Lot.Name").strip() == "L-7"
            await soon(lambda: _is(client, "Lot.Verdict", 4))  # spheres of 15 mm are smaller than d
            d50 = await (await node_of(client, "Figures.D50")).read_value()
            assert 14 < d50 < 16
            listed = told("uals", "-u", bridge.url, "-n", "ns=2;s=VisionSystem", "-d", "2")
            for name in ("Lot", "Verdict", "D50", "ResultManagement", "DeviceHealth"):
                assert name in listed
            assert "VisionSystem" in told("uabrowse", "-u", bridge.url, "-n", "i=85")
            while not getattr(
                event := await asyncio.wait_for(heard.events.get(), PATIENCE_S), "NodeId", None
            ):
                pass
            acknowledge = ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Acknowledge)
            await client.get_node(event.NodeId).call_method(
                acknowledge, event.EventId, ua.LocalizedText("seen")
            )
            alarms = asked(tmp_path, daemon, "GET", "/alarms")["items"]
            by_check = {each["check"]: each["acknowledged_by"] for each in alarms}
            assert by_check[event.ConditionName] == "key anna"
            assert await lot.call_method(await node_of(client, "Lot.CloseLot"), "L-7") == [0, ""]
            await soon(lambda: _is(client, "LastLot.Name", "L-7"))
            await soon(lambda: _is(client, "LastLot.Verdict", 4))
            daemon.process.kill()
            daemon.process.wait()
            await soon(lambda: _is(client, "DaemonAnswers", False))
            found = await (await node_of(client, "Counts.Measured")).read_data_value(
                raise_on_bad_status=False
            )
            assert (found.StatusCode.value, found.Value.Value) == (ua.StatusCodes.BadNoCommunication, None)
            assert (await lot.call_method(await node_of(client, "Lot.CloseLot"), "L-7"))[0] == -1


@pytest.mark.full
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("n_kills", "n_seen"), [(3, 20), pytest.param(50, 5, marks=pytest.mark.night)])
async def test_every_result_is_there_once_over_kills_of_the_bridge(
    tmp_path: Path, n_kills: int, n_seen: int
) -> None:
    """A client by the rule of the guide: events as they come, and what is missing by GetResults."""
    got: dict[int, str] = {}
    n_events = 0
    with plant(tmp_path) as (daemon, bridge, _):
        for _ in range(n_kills):
            heard = Heard()
            async with Client(bridge.url, timeout=60) as client:
                subscription = await client.create_subscription(100, heard)
                index = await client.get_namespace_index("urn:stonefall:opcua")
                kind = client.get_node(ua.NodeId("ResultReadyEventType", index))
                await subscription.subscribe_events(ua.ObjectIds.Server, [kind])
                await fill(client, got)
                for _ in range(n_seen):
                    event = await asyncio.wait_for(heard.events.get(), PATIENCE_S)
                    n_events += 1
                    assert got.setdefault(event.seq, event.ResultId) == event.ResultId
                bridge.kill()
            bridge.start()
        asked(tmp_path, daemon, "PUT", "/acquisition", {"state": "disarmed"})
        async with Client(bridge.url, timeout=60) as client:
            await soon(lambda: _is_idle(tmp_path, daemon))
            last_seq = asked(tmp_path, daemon, "GET", "/results?after=0&limit=1")["last_seq"]
            await soon(lambda: _is(client, "ResultManagement.Cursor", last_seq))
            await fill(client, got)
    assert sorted(got) == list(range(1, last_seq + 1))
    assert len(set(got.values())) == len(got)
    assert n_events == n_seen * n_kills


async def fill(client: Client, got: dict[int, str]) -> None:
    """Get what is missing after the last result without a gap before it."""
    management = await node_of(client, "ResultManagement")
    method = await node_of(client, "ResultManagement.GetResults")
    while True:
        after = next(seq for seq in range(len(got) + 1) if seq + 1 not in got)
        answer = await management.call_method(
            method, ua.Variant(after, ua.VariantType.UInt64), ua.Variant(100, ua.VariantType.UInt32)
        )
        _, _, last_seq, items, error, problem = answer
        assert error == 0, problem
        for item in map(json.loads, items):
            assert got.setdefault(item["seq"], item["id"]) == item["id"]
        if after + len(items) >= last_seq:
            return


async def _is(client: Client, path: str, value: object) -> bool:
    found = (await (await node_of(client, path)).read_data_value(raise_on_bad_status=False)).Value
    return found is not None and found.Value == value


def _is_idle(folder: Path, daemon: DaemonProcess) -> bool:
    return asked(folder, daemon, "GET", "/accounting")["in_progress"] == 0
