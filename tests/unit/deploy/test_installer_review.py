"""The review before an upgrade: what changes, how results shift, and who may switch."""

import io
import json
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pytest
from installer import review, service
from installer.host import Host, InstallError
from support.installed_host import NEW, OLD

SETTINGS = {
    OLD.version: {"api": {"port": 8080, "gone": None}, "optics": {"dust": 0.1}, "lots": {}},
    NEW.version: {"api": {"port": 8080, "more": {"a": 1}}, "optics": {"dust": 0.2}, "lots": {}},
}
CHANGED = {
    "field": "volume_mm3",
    "unit": "%",
    "n_stones": 50,
    "n_changed": 49,
    "mean": 0.1,
    "rms": 0.2,
    "largest": [{"id": "s1", "change": 0.9}],
}
SAME = {**CHANGED, "field": "sieve_size_mm", "n_changed": 0, "largest": []}


class Commands:
    """Answers the commands of both releases."""

    def __init__(self, compared: Mapping[str, Any], archived: int = 0) -> None:
        self.compared, self.archived = compared, archived
        self.ran: list[str] = []
        self.fails = ""

    def __call__(self, command: Sequence[str], _: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
        line = " ".join(command)
        version = line.partition("releases/")[2].partition("/")[0]
        self.ran.append(f"{version}: {line.partition('bin/stonefall ')[2].partition(' ')[0]}")
        assert line.startswith("runuser -u stonefall -- ")
        code, answer = 0, ""
        if "--version" in line:
            answer = f"stonefall {version}, API 1.0, algorithm {len(version)}"
        elif "check-config" in line:
            answer = json.dumps({"settings": SETTINGS[version], "problems": []})
        elif " archive " in line:
            code, answer = self.archived, "/x: 50 stones, calibration c, background of 16 cameras"
        elif " measure " in line:
            assert " nice -n 19 " in line and " --workers 1 " in line
            code = int(version == self.fails)
        elif " compare " in line:
            answer = json.dumps(self.compared)
        return subprocess.CompletedProcess(command, code, answer, "why" if code else "")


def reviewed(host: Host, commands: Commands, monkeypatch: pytest.MonkeyPatch) -> bool:
    monkeypatch.setattr(review.shutil, "chown", lambda *_: None)
    return review.review(replace(host, execute=commands), OLD, NEW, 50)


def compared(*beyond: str, **stones: Any) -> dict[str, Any]:
    return {
        "stones": {"n_common": 50, "words": [], "fields": [CHANGED, SAME], **stones},
        "lot": [{"figure": "d50_mm", "difference": 0.02}, {"figure": "d10_mm", "difference": None}],
        "beyond": list(beyond),
    }


def test_it_says_what_changes_and_measures_with_both_releases(
    host: Host, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    commands = Commands(compared())
    assert reviewed(host, commands, monkeypatch)
    said = capsys.readouterr().out
    for words in (
        "algorithm 5 -> 6: what each version changed",
        "schema 11 -> 12, migrated at the first start; 0.3.0 cannot read it then",
        "setting new: api.more.a = 1",
        "setting gone: api.gone (was null)",
        "default changed: optics.dust: 0.1 -> 0.2",
        "background of 16 cameras",
        "volume_mm3              49 of 50, mean +0.1000 %, rms 0.2000, largest +0.9000 (s1)",
        "as a lot: d50_mm +0.0200",
    ):
        assert words in said
    assert "sieve_size_mm" not in said and "api.port" not in said
    assert commands.ran[-4:] == ["0.10.0: archive", "0.3.0: measure", "0.10.0: measure", "0.10.0: compare"]


def test_shifts_beyond_the_limits_are_named_and_no_terminal_no_switch(
    host: Host, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert not reviewed(host, Commands(compared(*(f"figure {n} differs" for n in range(30)))), monkeypatch)
    said = capsys.readouterr().out
    assert "figure 19 differs" in said and "figure 20 differs" not in said and "and 10 more" in said
    monkeypatch.setattr("sys.stdin", io.StringIO())  # no terminal
    assert review.may_switch(NEW, is_within=True, is_agreed=True)
    assert not review.may_switch(NEW, is_within=False, is_agreed=True)
    assert not review.may_switch(NEW, is_within=True, is_agreed=False)


@pytest.mark.parametrize(("answer", "is_yes"), [("y", True), ("Yes", True), ("", False), ("n", False)])
def test_on_a_terminal_it_asks(answer: str, is_yes: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def ask(question: str) -> str:
        asked.append(question)
        return answer

    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", ask)
    assert review.may_switch(NEW, is_within=False, is_agreed=True) is is_yes
    assert asked == ["Results shift beyond the limits above. Switch to 0.10.0? [y/N] "]


def test_equal_results_no_stones_and_a_first_release(
    host: Host, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reviewed(host, Commands(compared(fields=[SAME])), monkeypatch)
    assert "all results are equal, bit for bit" in capsys.readouterr().out
    assert reviewed(host, Commands(compared(), archived=1), monkeypatch)
    assert "results were not compared: why" in capsys.readouterr().out
    assert review.review(host, None, NEW, 50)


def test_a_release_that_does_not_measure_is_not_switched_to(
    host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands = Commands(compared())
    commands.fails = NEW.version
    with pytest.raises(InstallError, match=r"0\.10\.0 does not measure the archived stones: why"):
        reviewed(host, commands, monkeypatch)
    monkeypatch.setattr(service, "_checked", lambda *_: {"settings": None, "problems": ["x"]})
    commands.fails = ""
    assert reviewed(host, commands, monkeypatch)
