"""Bridge and broker are killed again and again while results come, and the daemon answers badly: each comes once.

`mosquitto_sub` is who receives. What comes twice was acknowledged just before a kill: its id and revision tell it.
"""

import random
import signal
from functools import partial
from pathlib import Path

import pytest
import tomli_w
from support.bridge import tell
from support.eventually import eventually
from support.extents import Extent, first_quick
from support.fake_feed import FakeFeed, Refusal, Torn, serving
from support.mosquitto import Mosquitto, Subscriber
from support.warm_stonefall import WarmStonefall

RESULTS, DDATA = "stonefall/line-1/results", "spBv1.0/stonefall/DDATA/bridge/rig"


def start(folder: Path, url: str, port: int) -> WarmStonefall:
    mqtt = {"host": "127.0.0.1", "port": port, "tls": False, "prefix": "stonefall/line-1", "sparkplug": {}}
    (folder / "bridge.toml").write_text(
        tomli_w.dumps({"dir": "bridge", "daemon": {"url": url}, "mqtt": mqtt})
    )
    arguments = ("bridge", "--config", folder / "bridge.toml")
    return WarmStonefall(arguments, out=folder / "bridge.out", log=folder / "bridge.log")


def seqs(subscriber: Subscriber) -> list[int]:
    return [each.document["seq"] for each in subscriber.of(RESULTS)]


def is_past(subscriber: Subscriber, seq: int) -> bool:
    return seq in seqs(subscriber)


@pytest.mark.full
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("n_kills", first_quick([5, 50], Extent.NIGHT))
def test_each_result_comes_once_over_kills_of_bridge_and_broker(n_kills: int, tmp_path: Path) -> None:
    dice = random.Random(n_kills)  # noqa: S311 - nothing secret
    with (
        serving(FakeFeed()) as daemon,
        Mosquitto(tmp_path / "broker") as broker,
        Subscriber(broker, RESULTS, "stonefall/line-1/status", DDATA) as there,
    ):
        tell(daemon)
        bridge = start(tmp_path, daemon.url, broker.port)
        try:
            for _ in range(n_kills):
                begin = daemon.last_seq
                daemon.last_seq += 200  # more than is in flight, so that a kill falls among them
                eventually(partial(is_past, there, begin + dice.randint(1, 150)))
                if dice.random() < 0.5:
                    bridge.kill()
                    bridge.wait()
                    bridge = start(tmp_path, daemon.url, broker.port)
                else:
                    broker.kill()
                    broker.start()
                daemon.next_answers.append(dice.choice([Refusal(503, "store-held"), Torn(0.5)]))
            eventually(lambda: set(seqs(there)) == set(range(1, daemon.last_seq + 1)))
            eventually(lambda: len(there.of(DDATA)) > 0)
            bridge.send_signal(signal.SIGTERM)
            assert bridge.wait() == 0
            eventually(lambda: there.newest("stonefall/line-1/status") == {"status": "offline"})
        finally:
            bridge.kill()
            bridge.wait()
    assert "Traceback" not in (tmp_path / "bridge.log").read_text()
