"""`stonefall compare`: what differs is found and named, limits decide the exit code."""

import json
from pathlib import Path
from typing import Any

import pytest
from support.outcomes import measured
from typer.testing import CliRunner, Result

from service.base.errors import ServiceError, UsageError
from service.commands.cli import build_app
from service.commands.compare import revisions_of_lot
from service.commands.daemon_client import DaemonClient
from service.results.record import document_of
from service.results.version import CHANGES_GUIDE

N_STONES = 4


def stones(**fields: Any) -> list[dict[str, Any]]:
    shape = {
        "length_mm": 24.0,
        "width_mm": 20.0,
        "thickness_mm": 15.0,
        "max_feret_mm": 25.0,
        "min_feret_mm": 14.0,
    }
    return [
        document_of(measured(volume_mm3=1000.0 * number, sieve_size_mm=10.0 * number, **shape))
        | {"bundle": f"s{number}", "kind": "particle", "captured_at": "2026-01-01T00:00:00Z"}
        for number in range(1, N_STONES + 1)
    ]


def write(folder: Path, records: list[dict[str, Any]]) -> Path:
    folder.mkdir()
    (folder / "results.jsonl").write_text("".join(json.dumps(record) + "\n" for record in records))
    return folder


def compare(*arguments: object, **options: Any) -> Result:
    return CliRunner().invoke(build_app(["compare"]), ["compare", *map(str, arguments)], **options)


@pytest.fixture
def old(tmp_path: Path) -> Path:
    return write(tmp_path / "old", stones())


def test_equal_results_are_said_to_be_equal(old: Path, tmp_path: Path) -> None:
    new = write(tmp_path / "new", stones()[::-1])  # in whatever order
    done = compare(
        old, new, "--max-volume-percent", 0, "--max-axes-mm", 0, "--max-passing-percent", 0, "--same-words"
    )
    assert done.exit_code == 0, done.output
    assert "equal, bit for bit" in done.output
    assert CHANGES_GUIDE not in done.output


def test_the_largest_differences_are_named_and_limits_decide(old: Path, tmp_path: Path) -> None:
    records = stones()
    records[1]["volume_mm3"] *= 1.01
    records[2]["volume_mm3"] *= 0.97
    records[0]["sieve_size_mm"] += 0.25
    new = write(tmp_path / "new", records)
    found = json.loads(compare(old / "results.jsonl", new, "--json").stdout)
    volume, sieve = found["stones"]["fields"][:2]
    names = {each["field"] for each in found["stones"]["fields"]}
    assert names >= {"sphericity", "corey"}, "numbers without a unit are compared"
    assert not names & {"zingg_class", "surface_area_mm2", "min_box_mm"}
    assert (volume["field"], volume["n_changed"]) == ("volume_mm3", 2)
    assert [each["id"] for each in volume["largest"][:2]] == ["s3", "s2"]
    assert volume["largest"][0]["change"] == pytest.approx(-3.0)
    assert (volume["mean"], volume["rms"]) == (pytest.approx(-0.5), pytest.approx((10 / 4) ** 0.5))
    assert (sieve["largest"][0]["id"], sieve["largest"][0]["change"]) == ("s1", pytest.approx(0.25))
    assert found["beyond"] == []
    assert any(each["figure"] == "d50_mm" for each in found["lot"])

    assert compare(old, new, "--max-volume-percent", 3.1, "--max-sieve-mm", 0.3).exit_code == 0
    told = compare(old, new, "--max-volume-percent", 2.9, "--max-sieve-mm", 0.2)
    assert told.exit_code == 1
    assert "volume_mm3 of s3 differs by -3 %, more than 2.9" in told.output
    assert "sieve_size_mm of s1 differs by +0.25 mm, more than 0.2" in told.output
    assert compare(old, new, "--max-passing-percent", 0.01).exit_code == 1


def test_what_changed_names_both_algorithms_and_the_guide_to_them(tmp_path: Path) -> None:
    sides = [
        write(
            tmp_path / version,
            [{**stone, "quality": word, "algorithm_version": version} for stone in stones()],
        )
        for version, word in (("16", "good"), ("17", "reduced"))
    ]
    done = compare(*sides)
    assert f"algorithm 16 -> 17; what each version changed: {CHANGES_GUIDE}" in done.output
    twice = [{**stone, "quality": "reduced", "algorithm_version": "16"} for stone in stones()]
    assert "both of algorithm 16" in compare(sides[0], write(tmp_path / "again", twice)).output


def test_other_outcomes_and_qualities_and_missing_stones_are_named(old: Path, tmp_path: Path) -> None:
    records = stones()
    records[0]["quality"] = "degraded"
    records[1] |= {"outcome": "rejected", "reason": "multiple", "quality": None, "volume_mm3": None}
    new = write(tmp_path / "new", records[:3])
    done = compare(old, new)
    assert done.exit_code == 0
    assert "s1: quality good -> degraded" in done.output
    assert "s2: outcome measured -> rejected" in done.output
    assert "1 stones are in the old results alone: s4" in done.output
    told = compare(old, new, "--same-words")
    assert (told.exit_code, "outcome of s2 is rejected, was measured" in told.output) == (1, True)


def test_what_cannot_be_compared_is_an_error(old: Path, tmp_path: Path) -> None:
    other = write(tmp_path / "other", [{**stones()[0], "bundle": "x"}])
    assert isinstance(compare(old, other).exception, UsageError)
    missing = compare(old, tmp_path / "none").exception
    assert isinstance(missing, ServiceError) and "none" in str(missing)


class Store:
    """Answers in the place of a daemon: stone a was measured by three versions, b by one."""

    results = {  # noqa: RUF012 - a table
        1: {"id": "a", "revision": 1, "revises": None, "algorithm_version": "12"},
        2: {"id": "b", "revision": 1, "revises": None, "algorithm_version": "12"},
        3: {"id": "a", "revision": 2, "revises": 1, "algorithm_version": "13"},
        4: {"id": "a", "revision": 3, "revises": 3, "algorithm_version": "13"},
    }

    def ask(self, path: str) -> dict[str, Any]:
        if path.startswith("/particles?"):
            return {"items": [self.results[4], self.results[2]], "next_cursor": None}
        return self.results[int(path.rpartition("/")[2])]


@pytest.mark.parametrize(
    ("sides", "found"),
    [
        (("12", "13"), ({"a": 1, "b": 1}, {"a": 3})),
        (("r1", "r2"), ({"a": 1, "b": 1}, {"a": 2})),
    ],
)
def test_of_a_store_each_stone_is_taken_in_the_newest_result_of_a_side(
    monkeypatch: pytest.MonkeyPatch, sides: tuple[str, str], found: tuple[dict[str, int], dict[str, int]]
) -> None:
    monkeypatch.setattr(DaemonClient, "ask", lambda _, path: Store().ask(path))
    taken = revisions_of_lot(DaemonClient(), "L1", sides)
    assert tuple({name: record["revision"] for name, record in side.items()} for side in taken) == found
    with pytest.raises(UsageError, match=r"no stone of lot L1 has a result of 99"):
        revisions_of_lot(DaemonClient(), "L1", ("12", "99"))
