"""The real daemon reads its configuration again on SIGHUP: good, bad, and with what needs a restart."""

import json
import signal
from pathlib import Path

import pytest
from support.daemon_process import DaemonProcess
from support.diagnostics import files_of
from support.eventually import eventually
from support.small_recording import write_small_recording
from support.warm_stonefall import run_stonefall
from support.webhook_receiver import SECRET


@pytest.fixture
def daemon(tmp_path: Path) -> DaemonProcess:
    write_small_recording(tmp_path / "recording", n_stones=1)
    return DaemonProcess(tmp_path, tmp_path / "recording")


def reload(daemon: DaemonProcess, text: str) -> None:
    """Return when the service manager has been told that the reload has ended."""
    n_before = daemon.heard.count("READY=1")
    daemon.config_path.write_text(text)
    daemon.process.send_signal(signal.SIGHUP)
    eventually(lambda: daemon.heard.count("READY=1") > n_before)
    start = daemon.heard.index("RELOADING=1")
    assert daemon.heard[start + 1].startswith("MONOTONIC_USEC=")


@pytest.mark.full
def test_good_bad_and_partly_appliable_configurations(daemon: DaemonProcess) -> None:
    endpoint = (
        '[webhooks]\nallowed_hosts = ["127.0.0.1"]\n[[webhooks.endpoints]]\nname = "mes"\n'
        f'url = "http://127.0.0.1:9/"\nsecrets = ["{SECRET}"]\n'
    )
    with daemon:
        daemon.hear("READY=1")
        text = daemon.config_path.read_text()
        assert daemon.check("configuration", lambda check: check["status"] == "pass")["detail"] is None

        reload(daemon, text + "[optics]\ndust = 0.2\n" + endpoint)  # good
        assert daemon.get("/config")["settings"]["optics"]["dust"] == 0.2
        assert [each["name"] for each in daemon.get("/webhooks")["items"]] == ["mes"]
        assert daemon.check("configuration", lambda check: check["status"] == "pass")

        reload(daemon, text + "[optics]\ndust = -1.0\n")  # bad: the last good one stays
        config = daemon.get("/config")
        assert "dust must be positive" in config["problem"]
        assert config["settings"]["optics"]["dust"] == 0.2
        daemon.check("configuration", lambda check: "refused" in str(check["detail"]))
        daemon.wait_for(
            "/alarms", lambda found: "configuration" in [each["check"] for each in found["items"]]
        )

        reload(daemon, text.replace("slots = 1", "slots = 2") + "[optics]\ndust = 0.15\n")  # partly appliable
        config = daemon.get("/config")
        assert config["problem"] is None
        assert config["restart_needed_for"] == ["workers.slots"]
        assert config["settings"]["optics"]["dust"] == 0.15
        assert config["settings"]["workers"]["slots"] == 1
        assert daemon.get("/webhooks")["items"] == []
        daemon.check("configuration", lambda check: "workers.slots" in str(check["detail"]))
        daemon.hear_line("a restart is needed for workers.slots")
        changes = [entry for entry in daemon.get("/audit")["items"] if entry["who"] == "SIGHUP"]
        assert len(changes) == 2
        assert SECRET not in str(changes)

        out = daemon.folder / "out.tar.gz"
        url = daemon.url("").removesuffix("/api/v1")
        done = run_stonefall("diagnostics", out, "--config", daemon.config_path, "--url", url)
        assert "of the daemon at" in done.stdout, done
        state = json.loads(files_of(out.read_bytes())["configuration-state.json"])
        assert state["restart_needed_for"] == ["workers.slots"]
        assert daemon.stop() == 0
