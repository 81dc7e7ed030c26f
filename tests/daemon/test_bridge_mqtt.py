"""A foreign subscriber beside a real daemon: a lot opens, stones fall, the verdict turns, an alarm is acknowledged."""

import signal
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from support.daemon_process import DaemonProcess, free_port
from support.eventually import eventually
from support.mosquitto import Mosquitto, Subscriber
from support.small_recording import write_small_recording
from support.warm_stonefall import WarmStonefall
from support.wire import fields_of

from service.bridge.mqtt.sparkplug import METRICS

RIG = "loop = true\nspeed = 2.5"  # ten stones a second
JSON = "stonefall/line-1"
DEVICE = "spBv1.0/stonefall/{}/bridge/rig"
NAMES = {metric.alias: name for name, metric in METRICS.items()}


def metrics(subscriber: Subscriber) -> dict[str, Any]:
    """Return the newest value of each metric, as a host application has them."""
    values: dict[str, Any] = {}
    for each in list(subscriber.heard):
        if each.topic in (DEVICE.format("DBIRTH"), DEVICE.format("DDATA")):
            for number, content in fields_of(each.payload):
                if number == 2:
                    metric = dict(fields_of(content))
                    values[NAMES[metric[2]]] = next(
                        (metric[kind] for kind in range(10, 16) if kind in metric), None
                    )
    return values


@pytest.mark.full
@pytest.mark.timeout(600)
def test_a_subscriber_sees_a_lot_its_verdict_and_an_alarm(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=8)
    port = free_port()
    with Mosquitto(tmp_path / "broker") as broker, Subscriber(broker, f"{JSON}/#", "spBv1.0/#") as there:
        mqtt = {"host": "127.0.0.1", "port": broker.port, "tls": False, "prefix": JSON, "sparkplug": {}}
        config = {"dir": "bridge", "daemon": {"url": f"http://127.0.0.1:{port}"}, "mqtt": mqtt}
        (tmp_path / "bridge.toml").write_text(tomli_w.dumps(config))
        arguments = ("bridge", "--config", tmp_path / "bridge.toml")
        bridge = WarmStonefall(arguments, out=tmp_path / "bridge.out", log=tmp_path / "bridge.log")

        def newest(topic: str) -> dict[str, Any]:
            return there.newest(f"{JSON}/{topic}") or {}

        try:
            eventually(lambda: newest("state").get("daemon_answers") is False)
            eventually(lambda: newest("health").get("ready", True) is None)
            with DaemonProcess(tmp_path, tmp_path / "recording", rig=RIG, slots=2, port=port) as daemon:
                daemon.hear("READY=1")
                eventually(lambda: newest("health").get("ready") is True)
                assert newest("health")["is_simulated"] is True
                product = {"title": "basalt", "density_kg_m3": 2700, "lower_mm": 16, "upper_mm": 31.5}
                daemon.put("/products/basalt", {**product, "specification": "GC85-20"})
                daemon.post("/lots", {"lot": "L-7", "product": "basalt"})
                eventually(lambda: newest("lot").get("lot") == "L-7")
                eventually(lambda: newest("verdict").get("verdict") == "does_not_conform")  # smaller than d
                assert 14 < newest("verdict")["d50_mm"]["value"] < 16
                eventually(lambda: metrics(there).get("verdict") == b"does_not_conform")
                assert metrics(there)["lot"] == b"L-7"
                (alarm,) = daemon.wait_for("/alarms", lambda found: bool(found["items"]))["items"][:1]
                topic = f"alarms/{alarm['check']}"
                eventually(lambda: newest(topic).get("state") == "unacknowledged")
                daemon.post(f"/alarms/{alarm['id']}/acknowledge", {})
                eventually(lambda: newest(topic).get("state") in ("acknowledged", "normal"))
                daemon.put("/acquisition", {"state": "disarmed"})
                counts = daemon.wait_for("/accounting", lambda found: found["in_progress"] == 0)
                n_results = counts["measured"] + counts["rejected"] + counts["lost"]
                eventually(lambda: len(there.of(f"{JSON}/results")) >= n_results)
                came = [each.document for each in there.of(f"{JSON}/results")]
                assert [each["seq"] for each in came] == list(range(1, n_results + 1))
                stored = daemon.get("/results?after=0&limit=1000&fields=lean")["items"]
                assert came[: len(stored)] == stored
                eventually(lambda: metrics(there).get("result/seq") == n_results)
                daemon.process.kill()
                daemon.process.wait()
                eventually(lambda: newest("health").get("ready", True) is None)
                eventually(lambda: bool(there.of(DEVICE.format("DDEATH"))))
            bridge.send_signal(signal.SIGTERM)
            assert bridge.wait() == 0
            eventually(lambda: newest("status") == {"status": "offline"})
            eventually(lambda: bool(there.of("spBv1.0/stonefall/NDEATH/bridge")))
        finally:
            bridge.kill()
            bridge.wait()
    assert "Traceback" not in (tmp_path / "bridge.log").read_text()
