"""The gate: which tests a run has, what each took, and which of them a change can reach."""

import json
import sys
import time
from pathlib import Path

import pytest
from gate import durations, selection, steps
from gate.durations import Durations, Times, read_reports, tables, too_long
from gate.selection import reached_by, sources
from gate.sharing import RigsTogether
from gate.steps import RIGS, Extent, Runner, Step, stages

REPOSITORY = Path(__file__).parents[3]


def files_of(step: Step) -> list[str]:
    return [word for word in step.command if word.endswith(".py")]


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(steps, "KEPT", tmp_path)
    return tmp_path


# --- steps ---


def test_each_file_is_in_the_session_rigs_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)
    _, ((tests,), _) = stages(Extent.FULL)
    files = files_of(tests)
    assert sorted(files) == sorted(map(str, Path("tests").rglob("test_*.py")))
    is_rig = [file.startswith(RIGS) for file in files]
    assert is_rig == sorted(is_rig, reverse=True) and any(is_rig)
    assert "--full" in tests.command


def test_without_selected_files_there_is_no_session() -> None:
    _, ((tests,), _) = stages(Extent.QUICK, ["tests/unit/service/test_b.py", "tests/unit/pipeline/test_a.py"])
    assert files_of(tests) == ["tests/unit/pipeline/test_a.py", "tests/unit/service/test_b.py"]
    assert stages(Extent.QUICK, [])[-1][0] == []


def test_all_rigs_are_one_share_and_each_other_file_is_one() -> None:
    sharing = RigsTogether.__new__(RigsTogether)  # it is made for processes that run
    names = ("tests/live/test_a.py::test", "tests/soak/test_b.py::test", "tests/api/test_c.py::test")
    assert [sharing._split_scope(name) for name in names] == ["rigs", "rigs", "tests/api/test_c.py"]


def python(name: str, program: str) -> Step:
    return Step(name, (sys.executable, "-c", program))


def test_lanes_run_side_by_side_and_go_on_after_a_failure(kept: Path) -> None:
    wait = (
        f"import pathlib, time\nwhile not pathlib.Path('{kept}/go').exists(): time.sleep(0.01)\nprint('went')"
    )
    go = f"import pathlib, sys\npathlib.Path('{kept}/go').touch()\nsys.exit(3)"
    runner = Runner()
    runner.run([[python("waits", wait)], [python("goes", go), python("after", "sum(range(10**6))")]])
    ran = {each.step.name: each for each in runner.ran}
    assert {name: each.code for name, each in ran.items()} == {"waits": 0, "goes": 3, "after": 0}
    assert ran["waits"].step.printed.read_text() == "went\n"
    assert ran["waits"].wall_s > 0 < ran["after"].processor_s
    assert runner.running == []


def test_what_runs_is_ended_and_nothing_begins_after_it(kept: Path) -> None:
    runner = Runner()
    ready = kept / "ready"
    waits = f"import pathlib, time\npathlib.Path('{ready}').touch()\ntime.sleep(1000)"

    def end() -> None:
        while not ready.exists():
            time.sleep(0.01)
        runner.end()

    steps.threading.Thread(target=end).start()
    runner.run([[python("waits", waits), python("never", "")]])
    assert [(each.step.name, each.code) for each in runner.ran] == [("waits", -15)]


# --- durations ---


def report(name: str, when: str, duration: float, outcome: str = "passed") -> str:
    document = {
        "$report_type": "TestReport",
        "nodeid": name,
        "when": when,
        "duration": duration,
        "outcome": outcome,
    }
    return json.dumps(document)


def test_set_up_and_call_are_told_apart_and_a_failure_stays(tmp_path: Path) -> None:
    lines = [
        json.dumps({"$report_type": "SessionStart"}),
        report("t.py::a", "setup", 2.0),
        report("t.py::a", "call", 1.0, "failed"),
        report("t.py::a", "teardown", 0.5),
        report("t.py::b", "setup", 0.0, "skipped"),
    ]
    (tmp_path / "tests.jsonl").write_text("\n".join([*lines, '{"unfinished']))
    found = read_reports([tmp_path / "tests.jsonl", tmp_path / "missing.jsonl"])
    assert found["t.py::a"] == Times(2.0, 1.0, 0.5, "failed")
    assert found["t.py::b"].outcome == "skipped"


def run_of(gflops: float = durations.REFERENCE_GFLOPS, **calls_s: float) -> Durations:
    return Durations(
        utc="",
        extent=Extent.QUICK,
        wall_s=100.0,
        processor_s=150.0,
        gflops=gflops,
        steps={"types": (10.0, 9.0)},
        tests={f"tests/unit/test_x.py::{name}": Times(call_s=call_s) for name, call_s in calls_s.items()},
    )


def test_a_quick_test_has_ten_seconds_and_more_on_a_slower_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(durations, "LONGER", {})
    monkeypatch.setattr(durations, "N_PROCESSES", 1)
    (wrong,) = too_long(run_of(quick=9.0, slow=11.0))
    assert wrong.startswith("tests/unit/test_x.py::slow took 11.0 s, longer than 10 s")
    assert too_long(run_of(durations.REFERENCE_GFLOPS / 2, slow=11.0)) == []
    assert len(too_long(run_of(durations.REFERENCE_GFLOPS * 2, slow=11.0))) == 1


def test_a_test_that_shares_a_processor_has_as_much_more_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(durations, "LONGER", {})
    monkeypatch.setattr(durations.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(durations, "N_PROCESSES", 3)
    assert too_long(run_of(slow=14.0)) == []
    assert len(too_long(run_of(slow=16.0))) == 1


def test_an_exception_is_named_and_must_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(durations, "LONGER", {"tests/unit/test_x.py::slow": "waits for the plant"})
    assert too_long(run_of(slow=11.0)) == []
    assert too_long(run_of(quick=1.0)) == ["tests/unit/test_x.py::slow may take longer, and does not exist"]


def test_what_is_kept_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(durations, "FILE", tmp_path / "durations.json")
    assert durations.kept() is None
    durations.keep(run_of(a=1.0))
    again = durations.kept()
    assert again is not None and again.tests == run_of(a=1.0).tests
    told = "\n".join(tables(again))
    assert "tests/unit/test_x.py::a" in told
    (tmp_path / "durations.json").write_text("{")
    assert durations.kept() is None


# --- selection ---

TREE = {
    "pipeline/hull.py": "",
    "service/store/__init__.py": "from service.store import rows",
    "service/store/rows.py": "import pipeline.hull",
    "service/commands/cli.py": 'COMMANDS = {"serve": "service.serve"}',
    "service/serve.py": "",
    "tests/support/daemon.py": 'Path(sys.executable).with_name("stonefall")',
    "tests/support/stores.py": "import pytest\n@pytest.fixture\ndef store(): from service.store import rows",
    "tests/api/conftest.py": "from support import stores",
    "tests/api/test_api.py": "",
    "tests/unit/test_hull.py": "from pipeline import hull",
    "tests/unit/test_store.py": "def test_it(store): ...",
    "tests/unit/test_page.py": 'NAME = "deploy/demo.toml"',
    "tests/daemon/test_daemon.py": "from support import daemon",
}


@pytest.mark.parametrize(
    ("changed", "reached"),
    [
        (
            "pipeline/hull.py",
            ["tests/api/test_api.py", "tests/unit/test_hull.py", "tests/unit/test_store.py"],
        ),
        ("service/store/001.sql", ["tests/api/test_api.py", "tests/unit/test_store.py"]),
        ("service/serve.py", ["tests/daemon/test_daemon.py"]),
        ("tests/api/conftest.py", ["tests/api/test_api.py"]),
        ("deploy/demo.toml", ["tests/unit/test_page.py"]),
        ("tests/unit/test_hull.py", ["tests/unit/test_hull.py"]),
        ("pyproject.toml", sorted(name for name in TREE if "/test_" in name)),
        ("docs/nobody.txt", []),
    ],
)
def test_a_change_reaches_what_imports_names_or_starts_it(changed: str, reached: list[str]) -> None:
    assert reached_by([changed], TREE) == reached


def test_the_gate_itself_is_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)
    assert reached_by(["deploy/gate/selection.py"], sources()) == ["tests/unit/deploy/test_gate.py"]


def test_a_link_changes_with_its_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(REPOSITORY)
    monkeypatch.setattr(selection, "_git", lambda *asked: "deploy/client.py\n" if asked[0] == "diff" else "")
    assert selection.changed_files("HEAD") == ["deploy/client.py", "service/bridge/reference_client.py"]
