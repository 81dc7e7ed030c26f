"""The archive for support: what is in it, that no secret is, and that what fails takes nothing else with it."""

import base64
import json
import stat
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.configurations import KEY, KEY_SHA256, REPLAY
from support.diagnostics import files_of
from support.recordings import make_bundle, write_recording
from support.webhook_receiver import SECRET
from typer.testing import CliRunner

from service.base.redaction import scrubbed
from service.commands.cli import build_app
from service.configuration.settings import load_settings
from service.daemon.diagnostics import archive
from service.daemon.diagnostics.archive import Inputs, build_archive
from service.daemon.diagnostics.diagnostic_inputs import diagnostic_inputs
from service.store import open_store

CONFIG = f"""
{REPLAY}{KEY}[webhooks]
allowed_hosts = ["127.0.0.1"]
[[webhooks.endpoints]]
name = "mes"
url = "https://127.0.0.1/hook/in-the-path?apikey=in-the-query"
secrets = ["{SECRET}"]
secret_files = ["mes.secret"]
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    write_recording(tmp_path / "recording", [make_bundle(1)])
    (tmp_path / "mes.secret").write_text("whsec_" + base64.b64encode(32 * b"x").decode() + "\n")
    open_store(tmp_path / "state").close()
    path = tmp_path / "stonefall.toml"
    path.write_text(CONFIG)
    return path


@pytest.fixture
def inputs(config: Path) -> Inputs:
    return diagnostic_inputs(load_settings(config))


def test_what_is_in_it(inputs: Inputs) -> None:
    files = files_of(build_archive(inputs))
    assert files.keys() == {"README.txt", "configuration.json", "missing.txt", *archive.PARTS}
    store = json.loads(files["store.json"])
    assert store["schema"] >= 12
    assert store["accounting"]["triggers"] == 0
    assert store["alarms"] == store["events"] == []
    assert "numpy" in json.loads(files["versions.json"])["packages"]
    assert {"clock", "memory"} <= {finding["subject"] for finding in json.loads(files["host.json"])}
    assert json.loads(files["calibrations.json"])["configured"]["cameras"]
    assert files["missing.txt"].splitlines()[0].endswith("no daemon runs")


def test_the_configuration_has_no_secret(inputs: Inputs) -> None:
    everything = "\n".join(files_of(build_archive(inputs)).values())
    for secret in (KEY_SHA256, SECRET, "in-the-query", "in-the-path", base64.b64encode(32 * b"x").decode()):
        assert secret not in everything
    assert '"name": "mes"' in everything


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    secrets=st.lists(
        st.text(st.characters(codec="utf-8", exclude_categories=["Cs", "Cc", "Z"]), min_size=12), min_size=1
    ),
    where=st.sampled_from(["log.txt", "live document", "name of a member", "error", "text of a list"]),
)
def test_known_secrets_never_appear_however_they_look(
    secrets: list[str], where: str, inputs: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    planted = " ".join(f"before{secret}after" for secret in secrets)

    def fails(_: Inputs) -> None:
        raise RuntimeError(planted)

    makers = {"log.txt": lambda _: planted, "host.json": archive.PARTS["host.json"]}
    if where == "error":
        makers["host.json"] = fails
    monkeypatch.setattr(archive, "PARTS", makers)
    live = {
        "live document": {"a.json": {"b": {"c": planted}}},
        "name of a member": {"a.json": {planted: 1}},
        "text of a list": {"a.json": [1, [planted]]},
    }.get(where, {"a.txt": "nothing"})
    given_inputs = Inputs(
        store_dir=inputs.store_dir,
        calibration=inputs.calibration,
        needs=inputs.needs,
        secrets=frozenset(secrets),
        configuration=inputs.configuration,
        live=live,
    )
    content = build_archive(given_inputs)
    for text in files_of(content).values():
        for secret in secrets:
            assert secret not in text
            assert json.dumps(secret)[1:-1] not in text


@pytest.mark.parametrize(
    "secret",
    [
        "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw",
        "stonefall_" + 43 * "x",
        "hunter2-of-the-plant",
        "-----BEGIN EC PRIVATE KEY-----\nMHcCAQEE\n-----END EC PRIVATE KEY-----",
    ],
)
@pytest.mark.parametrize(
    "line",
    [
        "Authorization: Bearer {}",
        "GET /x?token={} HTTP/1.1",
        "password = '{}'",
        "http://u:{}@mes/",
        "http://u:at@{}@mes/",
        "http://mes/hook/{}/more",
        "https://mes:1/hook'{}?a",
        "see 'http://mes/a;key={}'",
        "POST http://mes?{}",
    ],
)
def test_what_looks_like_a_secret_is_scrubbed_where_nobody_knows_it(secret: str, line: str) -> None:
    text = scrubbed(f"first\n{line.format(secret)}\nlast")
    assert secret not in text
    assert "MHcCAQEE" not in text
    assert text.startswith("first\n")
    assert text.endswith("last") or "PRIVATE" in secret


@pytest.mark.parametrize("line", ["?&", "a.", "://", "http://", "token ", "=", "-----BEGIN ", "a:a@"])
def test_long_lines_are_scrubbed_in_time_that_grows_with_their_length(line: str) -> None:
    def processor_s(n: int) -> float:
        began_s = time.process_time()
        scrubbed(n * line)
        return time.process_time() - began_s

    short_s = min(processor_s(2_000) for _ in range(3))
    assert processor_s(40_000) < 100 * short_s + 0.2  # 20 times as long; squared it were 400 and seconds


def test_metrics_and_calibrations_are_left_as_they_are() -> None:
    text = 'stonefall_calibration_activated_timestamp_seconds 1.7e9\nstonefall_x{calibration_id="ab12"} 1.0\n'
    assert scrubbed(text) == text


def test_size_and_time_are_bounded_and_what_is_left_out_is_named(
    inputs: Inputs, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive, "MAX_PART_BYTES", 1000)
    monkeypatch.setattr(archive, "PARTS", {"log.txt": lambda _: 5000 * "x" + "newest"})
    files = files_of(build_archive(inputs))
    assert len(files["log.txt"]) == 1000
    assert files["log.txt"].endswith("newest")
    assert "log.txt: its first 4006 bytes" in files["missing.txt"]
    monkeypatch.setattr(archive, "MAX_S", -1.0)
    assert "log.txt: no time was left" in files_of(build_archive(inputs))["missing.txt"]


def test_the_command_writes_it_while_the_daemon_is_down(config: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.tar.gz"
    command = ["diagnostics", str(out), "--config", str(config), "--url", "http://127.0.0.1:1"]
    done = CliRunner().invoke(build_app(["diagnostics"]), command)
    assert done.exit_code == 0, done
    assert "no daemon was asked" in done.stdout
    assert stat.S_IMODE(out.stat().st_mode) == 0o600
    assert SECRET not in "".join(files_of(out.read_bytes()).values())
    again = CliRunner().invoke(build_app(["diagnostics"]), command)
    assert again.exit_code == 1
    assert "exists already" in str(again.exception)
