"""A control system reads the contacts of a real daemon: a lot, its verdict, an alarm; and the end of the daemon."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from pymodbus.client import ModbusTcpClient
from support.daemon_process import DaemonProcess, free_port
from support.eventually import eventually
from support.small_recording import write_small_recording
from support.warm_stonefall import WarmStonefall

from service.bridge.contacts.points import BITS, REGISTERS, Contact

RIG = "loop = true\nspeed = 2.5"  # ten stones a second


class Reader:
    """A controller that reads by the table of the guide."""

    def __init__(self, port: int) -> None:
        self.client = ModbusTcpClient("127.0.0.1", port=port)

    def on(self) -> set[Contact]:
        found = self.client.read_discrete_inputs(0, count=len(BITS)).bits
        return {bit.name for bit, is_on in zip(BITS, found, strict=False) if is_on}

    def words(self) -> dict[str, Any]:
        n_words = sum(register.n_words for register in REGISTERS)
        left = self.client.read_input_registers(0, count=n_words).registers
        found = {}
        for register in REGISTERS:
            words, left = left[: register.n_words], left[register.n_words :]
            found[register.name] = sum(word << 16 * place for place, word in enumerate(reversed(words)))
        return found

    def lot(self) -> str:
        return self.words()["lot"].to_bytes(64).rstrip(b"\0").decode()


@contextmanager
def bridged(folder: Path, daemon_port: int, **daemon: Any) -> Iterator[tuple[Reader, WarmStonefall]]:
    port = free_port()
    daemon |= {"url": f"http://127.0.0.1:{daemon_port}"}
    config = {"dir": "bridge", "daemon": daemon, "modbus": {"port": port}}
    (folder / "bridge.toml").write_text(tomli_w.dumps(config))
    process = WarmStonefall(
        ("bridge", "--config", folder / "bridge.toml"), out=folder / "bridge.out", log=folder / "bridge.log"
    )
    reader = Reader(port)
    try:
        eventually(reader.client.connect)
        yield reader, process
    finally:
        reader.client.close()
        process.kill()
        process.wait()


@pytest.mark.full
@pytest.mark.timeout(600)
def test_a_controller_sees_a_lot_its_verdict_an_alarm_and_the_end_of_the_daemon(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=8)
    port = free_port()

    def until(is_so: Callable[[set[Contact]], bool]) -> None:
        eventually(lambda: is_so(reader.on()))

    with bridged(tmp_path, port) as (reader, bridge):
        assert reader.on() == set()
        with DaemonProcess(tmp_path, tmp_path / "recording", rig=RIG, slots=2, port=port) as daemon:
            daemon.hear("READY=1")
            until(lambda on: Contact.RIG_READY in on)
            assert reader.on() - {Contact.HEARTBEAT} == {
                Contact.DAEMON_ANSWERS,
                Contact.RIG_READY,
                Contact.SIMULATED,
            }
            beat = reader.words()["heartbeat"]
            eventually(lambda: reader.words()["heartbeat"] not in (beat, beat + 1))
            product = {"title": "basalt", "density_kg_m3": 2700, "lower_mm": 16, "upper_mm": 31.5}
            daemon.put("/products/basalt", {**product, "specification": "GC85-20"})
            daemon.post("/lots", {"lot": "L-7", "product": "basalt"})
            until(lambda on: Contact.LOT_OPEN in on)
            assert reader.lot() == "L-7"
            eventually(lambda: reader.words()["verdict"] == 1)  # insufficient: too few stones
            until(lambda on: Contact.OUT_OF_LIMITS in on)  # spheres of 15 mm are smaller than d
            found = reader.words()
            assert found["verdict"] == 4
            assert 1400 < found["d50"] < 1600
            assert 50 <= found["lot_stones"] < 0xFFFF_FFFF
            until(lambda on: {Contact.ALARM, Contact.ALARM_UNACKNOWLEDGED} <= on)
            for alarm in daemon.get("/alarms")["items"]:
                daemon.post(f"/alarms/{alarm['id']}/acknowledge", {})
            until(lambda on: Contact.ALARM in on and Contact.ALARM_UNACKNOWLEDGED not in on)
            daemon.process.kill()
            daemon.process.wait()
            until(lambda on: not on)
            found = reader.words()
            assert (found["d50"], found["verdict"], found["lot_stones"]) == (0xFFFF, 0, 0xFFFF_FFFF)
            assert reader.lot().encode() == b""
        with DaemonProcess(tmp_path, tmp_path / "recording", rig=RIG, slots=2, port=port) as daemon:
            until(lambda on: {Contact.RIG_READY, Contact.LOT_OPEN} <= on)
            assert daemon.stop() == 0
        until(lambda on: not on)
        bridge.send_signal(15)
        assert bridge.wait() == 0
    assert "Traceback" not in (tmp_path / "bridge.log").read_text()


@pytest.mark.full
def test_a_wrong_key_is_told_and_shows_nothing(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=2)
    port = free_port()
    key = "bridge's own"
    digest = sha256(key.encode()).hexdigest()
    keys = f'{RIG}\n[[api.keys]]\nname = "bridge"\nsha256 = "{digest}"\nscopes = ["read"]\n'
    (tmp_path / "key").write_text("guessed")
    with DaemonProcess(tmp_path, tmp_path / "recording", rig=keys, port=port) as daemon:
        daemon.hear("READY=1")
        with bridged(tmp_path, port, key_file="key") as (reader, _):
            eventually(lambda: "401" in (tmp_path / "bridge.log").read_text())
            assert reader.on() == set()
            (tmp_path / "key").write_text(key)
            eventually(lambda: Contact.RIG_READY in reader.on())
