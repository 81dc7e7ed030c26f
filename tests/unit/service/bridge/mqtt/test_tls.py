"""TLS and passwords at a real broker: what is wrong is refused, told in the log, and in nothing else."""

import asyncio
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from support.certificates import Authority
from support.eventually import soon
from support.mosquitto import Mosquitto, Subscriber, write_passwords
from support.plants import FakePlant, result

from service.bridge.mqtt import link
from service.bridge.mqtt.outlet import run
from service.bridge.mqtt.settings import MqttSettings, SparkplugSettings

HOST = "localhost"
PASSWORD = "correct horse"  # noqa: S105 - of this test alone


@pytest.fixture
def broker(tmp_path: Path) -> Any:
    """A broker for TLS with client certificates and passwords, and a second port on which the test listens."""
    authority = Authority(tmp_path / "ours")
    certificate, key = authority.vouch("server", HOST)
    passwords = tmp_path / "passwords"
    write_passwords(passwords, stonefall=PASSWORD)
    more = f"""
cafile {authority.certificate}
certfile {certificate}
keyfile {key}
require_certificate true
allow_anonymous false
password_file {passwords}
"""
    with Mosquitto(tmp_path / "broker", more, has_plain=True) as started:
        (tmp_path / "password").write_text(f"{PASSWORD}\n")
        yield started, authority


def settings(folder: Path, port: int, authority: Authority, **more: Any) -> MqttSettings:
    certificate, key = authority.vouch("bridge")
    words: dict[str, Any] = {
        "host": HOST, "port": port, "ca_file": authority.certificate, "certificate_file": certificate,
        "key_file": key, "user": "stonefall", "password_file": folder / "password", "prefix": "stonefall/line-1",
        "sparkplug": SparkplugSettings(),
    }  # fmt: skip
    return MqttSettings(**{**words, **more})


async def test_the_right_certificates_and_password_are_let_in(tmp_path: Path, broker: Any) -> None:
    started, authority = broker
    plant = FakePlant(tmp_path)
    plant.fall(result(1))
    with Subscriber(started, "#") as there:
        task = asyncio.create_task(run(settings(tmp_path, started.port, authority), plant))
        await soon(
            lambda: (
                bool(there.of("stonefall/line-1/results"))
                and bool(there.of("spBv1.0/stonefall/DDATA/bridge/rig"))
            )
        )
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("authority", "its certificate is refused: "),
        ("host", "its certificate is refused: IP address mismatch, certificate is not valid for '127.0.0.1'"),
        ("client certificate", "TLSV1_ALERT_UNKNOWN_CA"),
        ("no client certificate", "CERTIFICATE_REQUIRED"),
        ("password", "it refuses the connection: Not authorized"),
        ("no password", "it refuses the connection: Not authorized"),
        ("no password file", "password_file"),
        ("plain", "the connection is lost"),
    ],
)  # fmt: skip
async def test_what_is_wrong_is_refused_and_told(
    wrong: str,
    told: str,
    tmp_path: Path,
    broker: Any,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(link, "FIRST_PAUSE_S", 0.05)
    monkeypatch.setattr(link, "LONGEST_PAUSE_S", 0.1)
    started, authority = broker
    others = Authority(tmp_path / "others")
    certificate, key = others.vouch("bridge")
    plain = dict.fromkeys(("ca_file", "certificate_file", "key_file"))
    changed: dict[str, Any] = {
        "authority": {"ca_file": others.certificate},
        "host": {"host": "127.0.0.1"},
        "client certificate": {"certificate_file": certificate, "key_file": key},
        "no client certificate": {"certificate_file": None, "key_file": None},
        "password": {"password_file": tmp_path / "wrong"},
        "no password": {"user": None, "password_file": None},
        "no password file": {"password_file": tmp_path / "missing"},
        "plain": {"tls": False, **plain},
    }[wrong]
    (tmp_path / "wrong").write_text("battery staple")
    plant = FakePlant(tmp_path)
    plant.fall(result(1))
    with Subscriber(started, "#") as there:
        task = asyncio.create_task(run(settings(tmp_path, started.port, authority, **changed), plant))
        await soon(lambda: caplog.text.count(told) >= 2)  # by each of the two forms
        await soon(lambda: "line-1" in caplog.text and "stonefall/bridge" in caplog.text)
        assert not task.done()
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        assert there.heard == []
    assert not any((tmp_path / name / "results.cursor").exists() for name in ("mqtt", "sparkplug"))
    assert PASSWORD not in caplog.text
    assert "battery" not in caplog.text
    assert len(caplog.records) <= 6, caplog.text  # two forms, at most three reasons each, once
