import os
from pathlib import Path

import pytest

from service.processing import compiled_code
from service.processing.compiled_code import FOLDER, LOCATORS, CodeLocator, code_digests, isolate_numba_cache


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "pipeline"
    for name, text in {
        "carving/field.py": "from pipeline.lens import bend\ndef inner(x): return bend(x)\n",
        "lens.py": "from pipeline import limits\ndef bend(x): return x * limits.MOST\n",
        "limits.py": "MOST = 3\n",
        "measuring/sieve.py": "def sieve(x): return x\n",
    }.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    monkeypatch.setattr(compiled_code, "SOURCES", folder)
    monkeypatch.setenv(FOLDER, str(tmp_path / "kept"))
    return folder


def digests(root: Path) -> dict[str, str]:
    """As a new process finds them."""
    code_digests.cache_clear()
    return dict(code_digests(root))


@pytest.mark.parametrize(
    ("changed", "text", "compiled_anew"),
    [
        ("limits.py", "MOST = 4\n", {"limits.py", "lens.py", "carving/field.py"}),
        ("carving/field.py", "def inner(x): return x\n", {"carving/field.py"}),
        ("measuring/sieve.py", '"""What."""\n\n# why\ndef sieve(x):\n    """Say it."""\n    return x\n', set()),
        ("limits.py", 'MOST = 3\n"""What it is."""\n', set()),
    ],
)  # fmt: skip
def test_only_what_rests_on_changed_code_is_compiled_anew(
    changed: str, text: str, compiled_anew: set[str], sources: Path, tmp_path: Path
) -> None:
    before = digests(tmp_path / "kept")
    (sources / changed).write_text(text)
    after = digests(tmp_path / "kept")
    assert {name for name in after if after[name] != before[name]} == compiled_anew


def test_what_was_found_for_the_same_bytes_is_read_again(sources: Path, tmp_path: Path) -> None:
    before = digests(tmp_path / "kept")
    (state,) = (tmp_path / "kept").glob("state-*.json")
    state.write_text(state.read_text().replace(before["lens.py"], "remembered"))
    assert digests(tmp_path / "kept")["lens.py"] == "remembered"
    state.write_text("damaged")
    assert digests(tmp_path / "kept") == before


def test_a_function_has_a_folder_for_its_code(sources: Path) -> None:
    code_digests.cache_clear()
    locator = CodeLocator.from_function(len, str(sources / "lens.py"))
    assert locator is not None
    assert Path(locator.get_cache_path()).is_dir()
    assert locator.get_source_stamp() in locator.get_cache_path()


def test_where_nothing_can_be_written_nothing_is_kept(
    sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(FOLDER, str(tmp_path / "file"))
    code_digests.cache_clear()
    assert CodeLocator.from_function(len, str(sources / "lens.py")) is None


@pytest.fixture
def no_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(FOLDER)
    monkeypatch.setenv(LOCATORS, "")


@pytest.mark.usefixtures("sources", "no_folder")
def test_without_the_variable_it_is_beside_the_sources_or_in_the_users_cache(
    sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    isolate_numba_cache()
    assert os.environ[FOLDER] == str(sources / "__pycache__")
    monkeypatch.delenv(FOLDER)
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    isolate_numba_cache()
    assert os.environ[FOLDER] == str(tmp_path / "cache/stonefall/numba")


@pytest.mark.usefixtures("sources", "no_folder")
def test_for_a_user_without_a_home_numba_finds_a_place(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(Path, "home", nowhere)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    isolate_numba_cache()
    assert FOLDER not in os.environ
    assert os.environ[LOCATORS] == ""
