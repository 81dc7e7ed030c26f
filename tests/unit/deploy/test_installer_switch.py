"""Switch from one release to another: backup, health gate, rollback and downgrade."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from installer import releases, service, switch
from installer.host import Host, InstallError
from installer.service import Readiness
from support.installed_host import NEW, OLD, Script


def answers(monkeypatch: pytest.MonkeyPatch, answer: Callable[[], Readiness]) -> None:
    monkeypatch.setattr(service, "ask_readiness", lambda url: answer())
    monkeypatch.setattr(service, "POLL_S", 0.0)
    for waiting in (service.wait_until_healthy, service.usual_readiness):
        monkeypatch.setattr(waiting, "__defaults__", (0.0,))


READY = Readiness(True, True, "ready")
HELD = Readiness(True, False, "the gate does not answer")
SILENT = Readiness(False, False, "connection refused")


def names(ran: Sequence[str]) -> list[str]:
    """Return the first words of the commands that change a host."""
    wanted = {"stop", "start", "backup", "restore", "later"}
    return [
        next(word for word in line.split() if word in wanted) for line in ran if wanted & set(line.split())
    ]


def test_an_upgrade_makes_a_backup_before_the_new_daemon_starts(
    host: Host, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers(monkeypatch, lambda: READY)
    assert switch.switch(replace(host, execute=script), NEW, may_restore=False)
    assert releases.current(host) == NEW
    assert names(script.ran) == ["stop", "backup", "start"]


@pytest.mark.parametrize("answer", [HELD, SILENT])
def test_an_unhealthy_release_is_rolled_back_with_its_database(
    host: Host, script: Script, monkeypatch: pytest.MonkeyPatch, answer: Readiness
) -> None:
    answers(monkeypatch, lambda: answer if releases.current(host) == NEW else READY)
    with pytest.raises(InstallError, match=r"Rolled back: 0\.3\.0 is the current release and runs"):
        switch.switch(replace(host, execute=script), NEW, may_restore=False)
    assert releases.current(host) == OLD
    assert script.schema == 11
    assert names(script.ran) == ["stop", "backup", "start", "stop", "later", "restore", "start"]


def test_a_rig_that_was_not_ready_before_need_not_be_after(
    host: Host, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers(monkeypatch, lambda: HELD)
    assert switch.switch(replace(host, execute=script), NEW, may_restore=False)
    assert releases.current(host) == NEW


def test_one_slow_answer_does_not_weaken_the_gate(monkeypatch: pytest.MonkeyPatch) -> None:
    said = iter([SILENT, HELD, READY, SILENT])
    monkeypatch.setattr(service, "ask_readiness", lambda url: next(said))
    monkeypatch.setattr(service, "POLL_S", 0.0)
    assert service.usual_readiness("http://127.0.0.1") == READY


@pytest.fixture
def upgraded(host: Host, script: Script, monkeypatch: pytest.MonkeyPatch) -> Host:
    """Return a host whose database a new release has migrated; only what is run from then on is remembered."""
    answers(monkeypatch, lambda: READY)
    scripted = replace(host, execute=script)
    switch.switch(scripted, NEW, may_restore=False)
    script.ran.clear()
    return scripted


def test_a_downgrade_across_schemas_is_said_first(upgraded: Host, script: Script) -> None:
    with pytest.raises(InstallError, match=r"without the 2 results measured since\. Nothing was changed"):
        switch.switch(upgraded, OLD, may_restore=False)
    assert names(script.ran) == []
    assert releases.current(upgraded) == NEW
    assert switch.switch(upgraded, OLD, may_restore=True)
    assert names(script.ran) == ["stop", "backup", "later", "restore", "start"]
    assert releases.current(upgraded) == OLD


def test_the_backup_to_be_restored_is_not_the_old_one_that_is_removed(upgraded: Host) -> None:
    folder = upgraded.path("/var/lib/stonefall/backups")
    (needed,) = folder.glob("before-*")
    os.utime(needed, (0, 0))
    for name in ("before-a.sqlite", "before-b.sqlite"):
        (folder / name).touch()
    assert switch.switch(upgraded, OLD, may_restore=True)
    assert len(list(folder.glob("before-*"))) == releases.KEEP and not needed.exists()


def test_a_failed_downgrade_brings_the_whole_database_back(
    upgraded: Host, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers(monkeypatch, lambda: SILENT if releases.current(upgraded) == OLD else READY)
    with pytest.raises(InstallError, match=r"Rolled back: 0\.10\.0"):
        switch.switch(upgraded, OLD, may_restore=True)
    assert names(script.ran) == ["stop", "backup", "later", "restore", "start", "stop", "restore", "start"]
    restored = [line for line in script.ran if " restore " in line]
    assert "0.3.0: " in restored[0] and "/before-0.10.0-" in restored[0]
    assert "0.10.0: " in restored[1] and "/before-0.3.0-" in restored[1]


def test_a_downgrade_that_failed_before_it_restored_anything_leaves_the_database(
    upgraded: Host, script: Script
) -> None:
    script.damaged = {OLD.version}
    with pytest.raises(InstallError, match=r"Rolled back: 0\.10\.0"):
        switch.switch(upgraded, OLD, may_restore=True)
    assert names(script.ran) == ["stop", "backup", "later", "restore", "stop", "start"]
    assert script.schema == NEW.schema


def test_a_daemon_of_another_release_is_not_taken_for_the_new_one(
    host: Host, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers(monkeypatch, lambda: READY)
    script.starts = OLD  # ExecStart in a drop-in
    with pytest.raises(
        InstallError, match=r"releases/0\.3\.0/bin/python was started, not 0\.10\.0.*Rolled back"
    ):
        switch.switch(replace(host, execute=script), NEW, may_restore=False)
    assert releases.current(host) == OLD


def test_a_configuration_that_the_new_release_refuses_stops_nothing(
    host: Host, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers(monkeypatch, lambda: READY)
    script.problems = {"0.10.0": ["[rig] no such key"], "0.3.0": ["known before"]}
    with pytest.raises(InstallError, match=r"nothing was changed: \[rig\] no such key"):
        switch.switch(replace(host, execute=script), NEW, may_restore=False)
    assert names(script.ran) == []
    script.problems["0.3.0"] = script.problems["0.10.0"]
    assert switch.switch(replace(host, execute=script), NEW, may_restore=False)


def test_a_running_daemon_is_not_stopped_with_a_configuration_that_no_release_reads(
    host: Host, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers(monkeypatch, lambda: READY)
    script.unreadable = {OLD.version, NEW.version}  # it runs with the last good one
    script.problems = {version: ["not TOML"] for version in script.unreadable}
    with pytest.raises(InstallError, match="nothing was changed: not TOML"):
        switch.switch(replace(host, execute=script), NEW, may_restore=False)
    assert names(script.ran) == []


def test_what_was_installed_by_hand_comes_back_and_is_no_release(
    host: Host, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_hand = Path(NEW.version)  # beside the folder of releases
    releases.set_link(host, by_hand)
    answers(monkeypatch, lambda: SILENT if releases.current(host) == NEW else READY)
    with pytest.raises(InstallError, match=r"Rolled back: 0\.10\.0 is the current release and runs"):
        switch.switch(replace(host, execute=script), NEW, may_restore=False)
    assert releases.read_link(host) == by_hand
    assert names(script.ran) == ["stop", "backup", "start", "stop", "start"]
