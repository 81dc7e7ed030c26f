"""Keys and metrics of the real daemon: `stonefall keys` beside it, and what Prometheus reads."""

import json
import urllib.error
import urllib.request
from http import HTTPStatus
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families
from support.daemon_process import DaemonProcess, free_port
from support.small_recording import write_small_recording
from support.warm_stonefall import run_stonefall

N_STONES = 3


def keys(daemon: DaemonProcess, *arguments: str) -> str:
    return run_stonefall("keys", *arguments, "--config", daemon.config_path, check=True).stdout.strip()


def fetch(daemon: DaemonProcess, path: str, token: str | None = None) -> tuple[int, str]:
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    try:
        with urllib.request.urlopen(urllib.request.Request(daemon.url(path), headers=headers)) as answer:  # noqa: S310
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as err:
        with err:
            return err.code, err.read().decode()


@pytest.mark.full
def test_a_key_works_and_dies_while_the_daemon_runs_and_metrics_agree(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=N_STONES)
    with DaemonProcess(tmp_path, tmp_path / "recording") as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda found: found["measured"] == N_STONES)
        token = keys(daemon, "create", "prometheus")
        assert fetch(daemon, "/metrics")[0] == HTTPStatus.UNAUTHORIZED
        status, text = fetch(daemon, "/metrics", token)
        assert status == HTTPStatus.OK
        counts = json.loads(fetch(daemon, "/accounting", token)[1])
        families = {family.name: family for family in text_string_to_metric_families(text)}
        stones = families["stonefall_stones"].samples
        assert sum(sample.value for sample in stones) == counts["triggers"] - counts["in_progress"]
        health = json.loads(fetch(daemon, "/health", token)[1])
        checks = {sample.labels["check"] for sample in families["stonefall_health_check"].samples}
        assert checks == health["checks"].keys()
        boss = keys(daemon, "create", "boss", "--scope", "read", "--scope", "configure")
        settings = json.loads(fetch(daemon, "/config", boss)[1])["settings"]
        assert settings["carving"]["n"] == 64
        keys(daemon, "revoke", "prometheus")
        status, text = fetch(daemon, "/metrics", token)
        assert (status, "was revoked at" in text) == (HTTPStatus.UNAUTHORIZED, True)
        entries = json.loads(fetch(daemon, "/audit", boss)[1])["items"]
        assert [(each["action"], each["subject"]) for each in entries] == [
            ("key created", "prometheus"),
            ("key created", "boss"),
            ("key revoked", "prometheus"),
        ]
        assert token not in daemon.log
        assert daemon.stop() == 0
    done = run_stonefall("audit", "verify", "--config", daemon.config_path, check=True)
    assert done.stdout.startswith("3 entries, whole")
    assert "Traceback" not in daemon.log


@pytest.mark.full
def test_a_screen_is_paired_beside_the_daemon_which_knows_who_asked_without_a_key(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=1)
    with DaemonProcess(tmp_path, tmp_path / "recording", port=free_port()) as daemon:
        daemon.hear("READY=1")
        mes = urllib.request.Request(daemon.url("/results"), headers={"User-Agent": "mes/2"})  # noqa: S310 - http
        urllib.request.urlopen(mes).close()  # noqa: S310 - http
        screen = daemon.post("/session/pairing", {})
        code, secret = screen["code"], {"secret": screen["secret"]}
        assert daemon.post("/session/pairing/claim", secret) == {"is_signed_in": False}
        pair = ("keys", "pair", code, "--name", "silo-2", "--yes", "--config", daemon.config_path)
        done = run_stonefall(*pair, check=True)
        assert f"code {code} is shown at 127.0.0.1" in done.stdout
        assert done.stderr.startswith("this is the first key: from now on every page and program needs one")
        assert done.stderr.endswith("\n  127.0.0.1  mes/2\n")  # before it the command itself
        assert daemon.post("/session/pairing/claim", secret) == {"is_signed_in": True}
        assert daemon.post("/session/pairing/claim", secret)["status"] == HTTPStatus.NOT_FOUND
        assert fetch(daemon, "/results")[0] == HTTPStatus.UNAUTHORIZED
        assert screen["secret"] not in daemon.log
        assert daemon.stop() == 0


def test_the_network_is_not_served_without_a_key(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=1)
    daemon = DaemonProcess(tmp_path, tmp_path / "recording")
    config = daemon.config_path
    config.write_text(config.read_text().replace("[api]\n", '[api]\nhost = "192.0.2.1"\n'))
    told = run_stonefall("serve", "--config", config)
    assert told.returncode == 1
    (line,) = told.stderr.splitlines()
    for words in ("api.host", "192.0.2.1", "[api]", "`stonefall keys create NAME --config FILE`"):
        assert words in line
    assert run_stonefall("check-config", config).returncode == 1
    keys(daemon, "create", "mes")
    assert run_stonefall("check-config", config).returncode == 0
