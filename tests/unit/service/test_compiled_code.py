import os
from pathlib import Path

import pytest

from service import compiled_code
from service.compiled_code import FOLDER, keep_apart


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "pipeline" / "carving" / "field.py"
    path.parent.mkdir(parents=True)
    path.write_text("def inner(x): return x\n")
    monkeypatch.setattr(compiled_code, "SOURCES", tmp_path / "pipeline")
    return path


def folder(monkeypatch: pytest.MonkeyPatch, given: Path | None) -> Path:
    if given is None:
        monkeypatch.delenv(FOLDER, raising=False)
    else:
        monkeypatch.setenv(FOLDER, str(given))
    keep_apart()
    return Path(os.environ[FOLDER])


def test_another_state_of_any_source_has_another_folder(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = folder(monkeypatch, tmp_path / "kept")
    assert before.parent == tmp_path / "kept"
    assert folder(monkeypatch, tmp_path / "kept") == before
    source.write_text("def inner(x): return x + 1\n")
    assert folder(monkeypatch, tmp_path / "kept") != before


@pytest.mark.usefixtures("source")
def test_a_process_that_was_started_by_another_shares_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = folder(monkeypatch, tmp_path / "kept")
    assert folder(monkeypatch, first) == first


def test_without_the_variable_it_is_beside_the_sources_or_in_the_users_cache(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert folder(monkeypatch, None).parent == source.parents[1] / "__pycache__"
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert folder(monkeypatch, None).parent == tmp_path / "cache/stonefall/numba"


@pytest.mark.usefixtures("source")
def test_for_a_user_without_a_home_numba_finds_a_place(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(Path, "home", nowhere)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv(FOLDER, raising=False)
    keep_apart()
    assert FOLDER not in os.environ
