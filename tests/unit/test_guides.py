"""The guides: their links lead somewhere, the front door stays short."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GUIDES = sorted(
    path
    for path in ROOT.rglob("README.md")
    if not {"node_modules", "site-packages"} & set(path.parts) and ".venv" not in path.parts
)


@pytest.mark.parametrize("guide", GUIDES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_lead_to_files(guide: Path) -> None:
    links = re.findall(r"\]\(([^)#]+?)(?:#[^)]*)?\)", guide.read_text(encoding="utf-8"))
    dead = [link for link in links if "://" not in link and not (guide.parent / link).exists()]
    assert not dead


def test_the_front_door_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


def test_tests_that_are_named_exist() -> None:
    named = set(
        re.findall(r"`(test_\w+[a-z0-9])`", (ROOT / "tests" / "README.md").read_text(encoding="utf-8"))
    )
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    assert len(named) > 50
    assert {name for name in named if f"def {name}(" not in sources} == set()
