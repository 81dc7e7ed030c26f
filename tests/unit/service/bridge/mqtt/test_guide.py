"""The guide: its tables are those of the code, its broker and its commands work as they stand there."""

import asyncio
import re
import shlex
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest
from support.certificates import Authority
from support.eventually import soon
from support.mosquitto import MOSQUITTO_SUB, Mosquitto, Subscriber, publish, write_passwords
from support.plants import FakePlant, result

from service.bridge.mqtt.connection import KEEPALIVE_S
from service.bridge.mqtt.json_topics import RECENT_S
from service.bridge.mqtt.link import FIRST_PAUSE_S, LONGEST_PAUSE_S
from service.bridge.mqtt.outlet import BATCH, run
from service.bridge.mqtt.payload import DataType
from service.bridge.mqtt.sparkplug import METRICS
from service.bridge.mqtt.topics import MAX_PAYLOAD_BYTES, STATES
from service.bridge.settings import load_bridge_settings

GUIDE = (Path(__file__).parents[5] / "service/bridge/README.md").read_text(encoding="utf-8")
SECTION = GUIDE.split("\n## MQTT")[1].split("\n## ")[0]
BLOCKS = re.findall(r"(?:^    .*\n)+", SECTION, re.M)


def block(begin: str) -> str:
    """Return the block of the guide that begins with a text, without its indent."""
    (found,) = [each for each in BLOCKS if each.startswith(f"    {begin}")]
    return re.sub("^    ", "", found, flags=re.M)


@pytest.mark.parametrize("topic", STATES)
def test_the_table_of_topics_has_the_fields_of_each(topic: str) -> None:
    (row,) = [line for line in SECTION.splitlines() if line.startswith(f"| `{topic}` |")]
    assert re.findall("`([a-z0-9_]+)`", row)[1:] == list(STATES[topic])


@pytest.mark.parametrize("data_type", DataType)
def test_the_table_of_metrics_has_names_and_units(data_type: DataType) -> None:
    found = [each for each in METRICS.values() if each.data_type is data_type]
    told = ", ".join(f"`{each.name}`" + (f" {each.unit}" if each.unit else "") for each in found)
    assert f"| {data_type.name.capitalize()} | {told} |" in SECTION


def test_numbers_are_those_of_the_code() -> None:
    for told in (
        f"{BATCH} results at a time", f"more than {MAX_PAYLOAD_BYTES // 1024} kB",
        f"after {2 * KEEPALIVE_S} s of silence", f"results of the last {RECENT_S:g} s",
        f"after {FIRST_PAUSE_S:g} s, then ever later, {LONGEST_PAUSE_S:g} s at most",
    ):  # fmt: skip
        assert told in SECTION, told


async def test_broker_bridge_and_subscriber_of_the_guide_work_together(tmp_path: Path) -> None:
    authority = Authority(tmp_path / "certificates")
    for name, host in (("broker", "localhost"), ("bridge", None)):
        authority.vouch(name, host)
    (tmp_path / "acl").write_text(block("user stonefall"))
    write_passwords(tmp_path / "passwords", stonefall="hush", mes="secret")
    (tmp_path / "password").write_text("hush\n")

    def here(text: str) -> str:
        text = re.sub(r"[\w/.-]*?(\w+\.(?:pem|key))", rf"{tmp_path}/certificates/\1", text)
        return re.sub(r"/etc/[\w-]+/", f"{tmp_path}/", text).replace("broker.plant", "localhost")

    plant = FakePlant(tmp_path / "plant")
    plant.fall(*(result(seq) for seq in range(1, 31)))
    listener = here(block("per_listener_settings")).split("listener 8883\n")[1]
    with (
        Mosquitto(tmp_path / "broker", listener, has_plain=True) as broker,
        Subscriber(broker, "spBv1.0/#") as scada,
    ):
        words = here(block("[mqtt]")).replace("[mqtt]\n", f"[mqtt]\nport = {broker.port}\n")
        (tmp_path / "bridge.toml").write_text(f'dir = "."\n{words}')
        wanted = load_bridge_settings(tmp_path / "bridge.toml").mqtt
        assert wanted is not None
        task = asyncio.create_task(run(wanted, plant))
        try:
            first, second = here(block("mosquitto_sub")).replace("8883", str(broker.port)).splitlines()
            assert await _heard(f"{first} -C 30") == [f'"seq": {seq},' for seq in range(1, 31)]
            told = await _heard(f"{second} -C 5")
            assert sorted(told) == sorted(f"stonefall/line-1/{name} " for name in (*STATES, "status"))
            assert scada.heard == []  # its primary host is not there yet
            publish(
                broker.plain_port,
                "spBv1.0/STATE/scada",
                b'{"online": true, "timestamp": 1}',
                is_retained=True,
            )
            await soon(lambda: len(scada.of("spBv1.0/plant/DDATA/bridge/rig")) == 30)
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task


async def _heard(command: str) -> list[str]:
    """Run a command of the guide until it has heard enough; return the first word of each line."""
    program, *words = shlex.split(command)
    assert program == "mosquitto_sub"
    process = await asyncio.create_subprocess_exec(MOSQUITTO_SUB, *words, stdout=subprocess.PIPE)
    out, _ = await asyncio.wait_for(process.communicate(), 120)
    return re.findall(r'"seq": \d+,|^stonefall\S* ', out.decode(), re.M)
