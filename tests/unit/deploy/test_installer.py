"""Decisions of the installer, without a host: versions, retention, files, rollback and downgrade, the self-test."""

import json
import sqlite3
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from installer import placement, releases, selftest, service, store, switch, uninstall
from installer.host import Host, InstallError
from installer.releases import Release
from installer.selftest import Reference
from installer.service import Readiness
from installer.store import Copy, Stock

ROOT = Path(__file__).parents[3]
OLD = Release("0.3.0", "c0ffee", "12", "amd64", schema=11, needs_mb=1)
NEW = replace(OLD, version="0.10.0", commit="decade", schema=12)
UNIT = "/etc/systemd/system/stonefall.service"


def put(host: Host, release: Release, unit: str = "[Unit]\n") -> None:
    """Put a release of a few files on a host."""
    folder = release.folder(host)
    for name, text in {
        "systemd/stonefall.service": unit,
        "systemd/stonefall.sysusers": "u stonefall -\n",
        "deploy/host/90-x.conf": "# Goes to /etc/sysctl.d/: buffers\n",
        "deploy/host/50-x.network": "# Goes to /etc/systemd/network/; Name= are the ports\n",
        "deploy/stonefall.toml": f"# of {release.version}\n",
    }.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    releases.mark_complete(release, folder)


@pytest.fixture
def host(tmp_path: Path) -> Host:
    host = Host(root=tmp_path)
    put(host, OLD)
    return host


def test_versions_are_ordered_by_their_numbers() -> None:
    ordered = ["0.3.0", "0.3.1", "0.9.9", "0.10.0a1", "0.10.0rc2", "0.10.0rc10", "0.10.0", "1.0.0", "10.0.0"]
    assert sorted(sorted(ordered), key=releases.version_key) == ordered
    assert releases.version_key("1.0") == releases.version_key("1.0.0")
    with pytest.raises(ValueError, match="is not like"):
        releases.version_key("newest")


def test_three_releases_are_kept_among_them_the_ones_in_use() -> None:
    every = [replace(OLD, version=f"0.{minor}.0") for minor in (3, 9, 10, 11, 12)]
    by_version = {release.version: release for release in every}

    def removed(*needed: str) -> list[str]:
        return [each.version for each in releases.expendable(every, [by_version[name] for name in needed])]

    assert removed("0.12.0", "0.11.0") == ["0.9.0", "0.3.0"]
    assert removed("0.3.0", "0.12.0") == ["0.10.0", "0.9.0"]  # gone back to the oldest: it stays
    assert removed("0.12.0", "0.12.0") == ["0.9.0", "0.3.0"]
    assert releases.expendable(every[:3], [None]) == []


def test_the_current_release_changes_at_one_moment(host: Host) -> None:
    put(host, NEW)
    for release in (OLD, NEW, OLD):
        releases.make_current(host, release)
        assert releases.current(host) == release
    assert host.path(releases.CURRENT).readlink() == Path("releases/0.3.0")


def test_an_interrupted_release_does_not_count(host: Host) -> None:
    put(host, NEW)
    (NEW.folder(host) / releases.COMPLETE).unlink()
    releases.make_current(host, NEW)
    assert releases.installed(host) == [OLD]
    assert releases.current(host) is None


@pytest.mark.parametrize("text", ["{", "{}", json.dumps({**vars(OLD), "version": "../x"})])
def test_a_wrong_description_of_a_release_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bundle.json"
    path.write_text(text)
    with pytest.raises(InstallError, match=r"bundle\.json: "):
        releases.read_release(path)


def test_files_are_placed_once_and_an_edited_one_stays(host: Host) -> None:
    assert placement.place(host, OLD) == [
        "/etc/systemd/network/50-x.network.default",  # ports of another machine: only an example
        "/etc/sysctl.d/90-x.conf",
        UNIT,
        "/etc/sysusers.d/stonefall.conf",
        "/etc/stonefall/stonefall.toml",
    ]
    assert placement.place(host, OLD) == []

    put(host, NEW, unit="[Unit]\nDescription=new\n")
    host.path("/etc/stonefall/stonefall.toml").write_text("# mine\n")
    assert placement.place(host, NEW) == [UNIT, "/etc/stonefall/stonefall.toml.default"]
    assert host.path("/etc/stonefall/stonefall.toml").read_text() == "# mine\n"
    assert UNIT in placement.place(host, OLD)  # a rollback brings the unit of its release

    host.path(UNIT).write_text("[Unit]\nDescription=mine\n")
    assert f"{UNIT}.default" in placement.place(host, NEW)
    assert host.path(UNIT).read_text() == "[Unit]\nDescription=mine\n"
    assert dict(placement.placed(host, [OLD, NEW])) == {
        "/etc/sysctl.d/90-x.conf": False,
        "/etc/systemd/network/50-x.network.default": False,
        UNIT: True,
        f"{UNIT}.default": False,
        "/etc/sysusers.d/stonefall.conf": False,
    }


def test_the_configuration_is_not_even_replaced_when_unedited(host: Host) -> None:
    placement.place(host, OLD)
    put(host, NEW)
    assert placement.place(host, NEW) == ["/etc/stonefall/stonefall.toml.default"]
    assert host.path("/etc/stonefall/stonefall.toml").read_text() == "# of 0.3.0\n"


def test_a_dry_run_changes_nothing(host: Host, capsys: pytest.CaptureFixture[str]) -> None:
    dry = replace(host, dry_run=True)
    before = sorted(host.root.rglob("*"))
    assert len(placement.place(dry, OLD)) == 5
    assert switch.activate(dry, OLD)
    assert sorted(host.root.rglob("*")) == before
    assert UNIT in capsys.readouterr().out


def test_every_file_of_the_repository_has_its_place() -> None:
    targets = [each.target for each in placement.placements(ROOT)]
    assert len(targets) == len(set(targets))
    assert "/etc/systemd/system/stonefall.service.d/networks.conf" in targets
    assert all(target.startswith("/etc/") for target in targets)


def copy(name: str, schema: int, last_seq: int, modified_at: float = 0.0) -> Copy:
    return Copy(name, schema, last_seq, modified_at)


def test_an_older_release_takes_the_newest_backup_that_it_can_read() -> None:
    in_use = copy("results.sqlite", 12, 100)
    backups = (copy("a", 10, 40), copy("b", 11, 70, 1.0), copy("c", 12, 100), copy("d", 11, 70, 2.0))
    assert switch.plan_return(NEW, Stock(in_use, backups)) == switch.Return(None, 0)
    assert switch.plan_return(OLD, Stock(None, backups)) == switch.Return(None, 0)
    assert switch.plan_return(OLD, Stock(in_use, backups)) == switch.Return(backups[3], 30)
    with pytest.raises(InstallError, match=r"schema 12, 0\.3\.0 reads schemas up to 11"):
        switch.plan_return(OLD, Stock(in_use, backups[2:3]))


def database(path: Path, schema: int, n: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    connection = sqlite3.connect(path)
    connection.executescript(
        "CREATE TABLE store (last_seq INTEGER); CREATE TABLE results (seq INTEGER, id TEXT, record TEXT)"
    )
    connection.execute(f"PRAGMA user_version = {schema}")
    connection.execute("INSERT INTO store VALUES (?)", (n,))
    connection.executemany(
        "INSERT INTO results VALUES (?, ?, ?)", [(i, f"s{i}", '{"outcome": "lost"}') for i in range(1, n + 1)]
    )
    connection.commit()
    connection.close()


def test_what_a_backup_does_not_have_is_written_out(tmp_path: Path) -> None:
    assert store.look(tmp_path) == Stock(None, ())
    database(tmp_path / "results.sqlite", 12, 5)
    database(tmp_path / "backups/before-1.sqlite", 11, 3)
    (tmp_path / "backups/torn.sqlite").write_bytes(b"SQLite format 3\0 and then nothing")
    stock = store.look(tmp_path)
    assert stock.in_use is not None and (stock.in_use.schema, stock.in_use.last_seq) == (12, 5)
    assert [(Path(each.path).name, each.schema) for each in stock.backups] == [("before-1.sqlite", 11)]
    assert store.write_later(tmp_path / "results.sqlite", 3, tmp_path / "later.jsonl") == 2
    lines = [json.loads(line) for line in (tmp_path / "later.jsonl").read_text().splitlines()]
    assert lines == [{"seq": i, "id": f"s{i}", "outcome": "lost"} for i in (4, 5)]


TRUE = [{"bundle": "1-sphere", "outcome": "measured", "volume_mm3": 1767.1, "sieve_size_mm": 15.0}]


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({}, None),
        ({"volume_mm3": 1768.0}, None),
        ({"volume_mm3": 1770.0}, "volume_mm3 is 1770.000, but 1767.100 by the host that made"),
        ({"sieve_size_mm": 15.3}, "15.000 by the body's true shape"),
        ({"sieve_size_mm": float("nan")}, "sieve_size_mm is nan"),
        ({"outcome": "rejected"}, "1-sphere: rejected, not measured"),
        ({"bundle": "another"}, "1-sphere: no result, not measured"),
    ],
)
def test_the_self_test_can_fail(change: Mapping[str, object], found: str | None) -> None:
    expected = [each for reference in Reference for each in selftest.expectations(TRUE, reference)]
    problems = selftest.deviations(expected, [{**TRUE[0], **change}])
    assert problems == [] if found is None else found in "; ".join(problems)


class Script:
    """A host's commands: answers them, and remembers what was run."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.ran: list[str] = []
        self.schema = 11
        self.backups: list[Copy] = []
        self.problems: dict[str, list[str]] = {}

    @property
    def last_seq(self) -> int:
        return 5 if self.schema == 12 else 3

    def __call__(self, command: Sequence[str], _: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
        words = [Path(word).name if "/bin/" in word else word for word in command]
        line = " ".join(words).removeprefix("runuser -u stonefall -- ")
        release = next((part for part in command if "releases/" in part), "").removeprefix(
            releases.FOLDER + "/"
        )
        answer = ""
        if "is-active" in line:
            answer = "active\n"
        elif "check-config" in line:
            settings = {"store": {"dir": "/var/lib/stonefall"}, "api": {"host": "0.0.0.0", "port": 8080}}  # noqa: S104
            problems = self.problems.get(release.split("/")[0], [])
            answer = json.dumps({"settings": settings, "problems": problems})
        elif "installer.store look" in line:
            in_use = vars(copy("results.sqlite", self.schema, self.last_seq))
            answer = json.dumps({"in_use": in_use, "backups": [vars(each) for each in self.backups]})
        elif "installer.store later" in line:
            answer = "2\n"
        elif " backup " in line:
            name = next(word for word in command if word.endswith(".sqlite"))
            self.backups.append(copy(name, self.schema, self.last_seq))
        elif " restore " in line:
            self.schema = next(each.schema for each in self.backups if each.path in command)
        elif "systemctl start" in line and releases.current(self.host) == NEW:
            self.schema = 12  # the daemon migrates
        if not any(word in line for word in ("check-config", "is-active", "look", "reset-failed")):
            self.ran.append(f"{release.split('/')[0]}: {line}")
        return subprocess.CompletedProcess(command, 0, answer, "")


@pytest.fixture
def script(host: Host) -> Script:
    put(host, NEW)
    host.path("/run/systemd/system").mkdir(parents=True)
    host.path("/var/lib/stonefall").mkdir(parents=True)
    releases.make_current(host, OLD)
    placement.place(host, OLD)
    return Script(host)


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


def test_a_downgrade_across_schemas_is_said_first(
    host: Host, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers(monkeypatch, lambda: READY)
    scripted = replace(host, execute=script)
    switch.switch(scripted, NEW, may_restore=False)
    script.ran.clear()
    with pytest.raises(InstallError, match=r"without the 2 results measured since\. Nothing was changed"):
        switch.switch(scripted, OLD, may_restore=False)
    assert names(script.ran) == []
    assert releases.current(host) == NEW
    assert switch.switch(scripted, OLD, may_restore=True)
    assert names(script.ran) == ["stop", "backup", "later", "restore", "start"]
    assert releases.current(host) == OLD


def test_a_failed_downgrade_brings_the_whole_database_back(
    host: Host, script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers(monkeypatch, lambda: READY)
    scripted = replace(host, execute=script)
    switch.switch(scripted, NEW, may_restore=False)
    script.ran.clear()
    answers(monkeypatch, lambda: SILENT if releases.current(host) == OLD else READY)
    with pytest.raises(InstallError, match=r"Rolled back: 0\.10\.0"):
        switch.switch(scripted, OLD, may_restore=True)
    assert names(script.ran) == ["stop", "backup", "later", "restore", "start", "stop", "restore", "start"]
    restored = [line for line in script.ran if " restore " in line]
    assert "0.3.0: " in restored[0] and "/before-0.10.0-" in restored[0]
    assert "0.10.0: " in restored[1] and "/before-0.3.0-" in restored[1]


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


def test_uninstalling_leaves_results_and_what_was_edited(host: Host, script: Script) -> None:
    scripted = replace(host, execute=script)
    results = host.path("/var/lib/stonefall/results.sqlite")
    results.write_text("results")
    host.path("/etc/sysctl.d/90-x.conf").write_text("# mine\n")
    with pytest.raises(InstallError, match="nothing was changed"):
        uninstall.uninstall(scripted, "yes")
    assert host.path(UNIT).exists()
    uninstall.uninstall(scripted, None)
    left = {str(path.relative_to(host.root)) for path in host.root.rglob("*") if path.is_file()}
    assert left == {
        "var/lib/stonefall/results.sqlite",
        "etc/stonefall/stonefall.toml",
        "etc/sysctl.d/90-x.conf",
    }
    uninstall.uninstall(scripted, uninstall.WORDS)
    assert not results.exists()


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """Return a bundle's folder with everything that is looked at before Python is needed."""
    folder = tmp_path / "stonefall-0.3.0"
    (folder / "deploy").mkdir(parents=True)
    for name in ("install", "apt-packages.txt"):
        (folder / "deploy" / name).write_bytes((ROOT / "deploy" / name).read_bytes())
    (folder / "numpy.whl").write_bytes(b"whole")
    return folder


def refusal(folder: Path, release: Release) -> str:
    """Return what the installer says of a bundle that it refuses."""
    (folder / "bundle.json").write_text(json.dumps(vars(release), indent=4))
    done = subprocess.run(
        ["bash", folder / "deploy/install", "--dry-run"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 1
    return done.stderr


def add_sums(folder: Path) -> None:
    names = ["numpy.whl", "deploy/install"]
    sums = subprocess.run(["sha256sum", *names], cwd=folder, capture_output=True, check=True).stdout
    (folder / "SHA256SUMS").write_bytes(sums)


def test_a_damaged_bundle_is_refused_before_anything(bundle: Path) -> None:
    add_sums(bundle)
    (bundle / "numpy.whl").write_bytes(b"torn!")
    assert "the bundle is damaged, nothing was changed; copy it again: numpy.whl: FAILED" in refusal(
        bundle, OLD
    )
    (bundle / "numpy.whl").unlink()
    assert "numpy.whl: No such file" in refusal(bundle, OLD)
    (bundle / "SHA256SUMS").unlink()
    assert "SHA256SUMS: No such file" in refusal(bundle, OLD)


def test_a_host_of_another_kind_or_without_room_is_refused(bundle: Path) -> None:
    add_sums(bundle)
    own = subprocess.run(["dpkg", "--print-architecture"], capture_output=True, text=True, check=True)
    here = replace(OLD, architecture=own.stdout.strip())
    assert "the bundle is for vax" in refusal(bundle, replace(here, architecture="vax"))
    assert "it needs 999999999999 MB of disk" in refusal(bundle, replace(here, needs_mb=999999999999))
