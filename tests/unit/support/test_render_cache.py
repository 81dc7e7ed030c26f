"""Rendered things are kept by what they are made of, and read by the next process."""

from collections.abc import Callable
from pathlib import Path

import pytest
from support import render_cache
from support.render_cache import kept_rendered

rendered: list[float] = []


def sphere(diameter_mm: float) -> list[float]:
    rendered.append(diameter_mm)
    return [diameter_mm]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    rendered.clear()
    monkeypatch.setattr(render_cache, "FOLDER", tmp_path)
    return tmp_path


def next_process() -> Callable[[float], list[float]]:
    return kept_rendered(sphere)


def test_it_is_rendered_once_for_all_processes() -> None:
    assert [next_process()(10.0) for _ in range(3)] == [[10.0]] * 3
    assert next_process()(12.0) == [12.0]
    assert rendered == [10.0, 12.0]


def test_other_code_renders_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    next_process()(10.0)
    monkeypatch.setattr(render_cache, "_code", lambda module: ("other code",))
    next_process()(10.0)
    assert rendered == [10.0, 10.0]


def test_the_code_is_that_of_support_and_of_the_pipeline_it_imports() -> None:
    code = {
        line.split()[0] for line in render_cache._code(Path(render_cache.__file__).with_name("rendered.py"))
    }
    assert {"rendered.py", "render_cache.py", "evaluation/scene.py", "synthesis/bundles.py"} <= code


def test_what_was_not_used_for_longest_is_removed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    next_process()(10.0)
    (entry,) = folder.glob("*.pickle")
    monkeypatch.setattr(render_cache, "MAX_BYTES", entry.stat().st_size * 3 // 2)
    next_process()(12.0)
    next_process()(10.0)
    assert rendered == [10.0, 12.0, 10.0]
