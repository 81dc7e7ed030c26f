"""The guides: links lead somewhere, the front door is short, what the pages name exists, all decisions are indexed."""

import re
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import typer
from benchmarks.figures import in_guide, is_outdated, read_figures, tables, used_figures

from service.commands.cli import COMMANDS, build_app, is_installed
from service.health.alarms.rules import Priority, load_rules

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


def test_rooms_of_the_services_guide_exist() -> None:
    service = ROOT / "service"
    rooms = re.findall(r"^\| `([\w/]+/)` \|", (service / "README.md").read_text(encoding="utf-8"), re.M)
    assert len(rooms) > 10
    assert [room for room in rooms if not (service / room / "__init__.py").exists()] == []


def test_the_index_of_decisions_is_complete() -> None:
    """Each decision of a guide has its row, whose links lead to just the guides that have it."""
    decided = {
        (int(number), guide)
        for guide in GUIDES
        for number in re.findall(r"^- \*\*(\d+)\. ", guide.read_text(encoding="utf-8"), re.M)
    }
    index = ROOT / "service" / "README.md"
    rows = re.findall(r"^\| (\d+) \| .+? \| (.+) \|$", index.read_text(encoding="utf-8"), re.M)
    indexed = [
        (int(number), (index.parent / link).resolve() if link else index)
        for number, links in rows
        for link in re.findall(r"\]\(([^)#]*)#decisions\)", links)
    ]
    assert sorted(indexed) == sorted(decided)
    assert [int(number) for number, _ in rows] == sorted({number for number, _ in decided})


def papers_page() -> str:
    guide = (ROOT / "pipeline" / "README.md").read_text(encoding="utf-8")
    return guide.split("\n## The paper, sentence by sentence\n")[1].split("\n## ")[0]


def test_files_of_the_papers_page_exist() -> None:
    named = set(re.findall(r"`((?:\w+/)*\w+\.py)`", papers_page()))
    assert len(named) > 10
    assert [
        name for name in named if not (ROOT / name).exists() and not (ROOT / "pipeline" / name).exists()
    ] == []


def commands_of(guide: Path) -> Iterator[tuple[str, bool]]:
    """Yield the commands of a guide, and whether each stands in a block, from where people paste it."""
    text = guide.read_text(encoding="utf-8").replace("\\\n", " ")
    if guide == ROOT / "README.md":  # its list of commands has words beside each
        head, _, tail = text.partition("\n## Commands\n")
        text = head + tail.partition("\nFirst REST calls")[2]
    is_fenced = False
    for line in text.splitlines():
        is_fenced ^= line.strip().startswith("```")
        found = re.findall(r"`stonefall ([^`]+)`", line)
        is_block = is_fenced or line.startswith("    ")
        if is_block:
            found = re.findall(
                r"(?:^|&& |; |do |\$ |\w=\S+ )\s*(?:\S+/)?stonefall (.+?)(?=$|\s#| && |; )", line.strip()
            )
        yield from ((each, is_block) for each in found)


def known_words(name: str, words: Sequence[str]) -> tuple[Any, Sequence[str]]:
    """Return the command of a line, of several the one that it names, and its own words."""
    command: Any = typer.main.get_command(build_app([name]))
    command = command.commands[name]
    while words and words[0] in getattr(command, "commands", ()):
        command, words = command.commands[words[0]], words[1:]
    return command, words


@pytest.mark.parametrize("guide", GUIDES, ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_of_the_guides_can_be_pasted(guide: Path) -> None:
    """Whole lines are taken as they are; of a list (`[--x]`, `a | b`, `...`) commands and options exist."""
    for line, is_block in commands_of(guide):
        name, *words = re.split(r"\s+", re.split(r" [|>&] |\s2>", line)[0].strip())
        if name.startswith("--"):
            continue
        assert name in COMMANDS, line
        if not is_installed(COMMANDS[name]):
            continue
        command, own = known_words(name, words)
        options = {
            option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)
        }
        named = {word for each in own for word in re.findall(r"--[a-z0-9-]+", each)}
        assert named <= options | {"--help"}, line
        if is_block and not re.search(r"[\[\]|]|\.\.\.", line):
            command.make_context(name, shlex.split(" ".join(own)))


def test_symptoms_are_those_that_doctor_and_health_name() -> None:
    """Each name is a check or a subject of `doctor`; each check whose alarm cannot wait has a symptom."""
    guide = (ROOT / "deploy" / "days" / "README.md").read_text(encoding="utf-8")
    table = guide.split("\n## What is wrong, by what you see\n")[1]
    rows = re.findall(r"^\| (.+) \| (`.+`) \| (.+) \|$", table, re.MULTILINE)
    named = {name for _, names, _ in rows for name in re.findall("`(.+?)`", names)}
    sources = [*(ROOT / "service" / "host").glob("*.py"), *(ROOT / "service" / "commands").glob("doctor*.py")]
    judged = "\n".join(path.read_text(encoding="utf-8") for path in sources)
    subjects = set(re.findall(r'(?:judged|fault|unknown)\(\s*"([^"]+)"', judged))
    rules = load_rules()
    assert len(rows) > 15
    assert named <= subjects | set(rules.checks)
    cannot_wait = {Priority.URGENT, Priority.HIGH}
    assert {name for name, rule in rules.by_check.items() if {rule.warn, rule.fail} & cannot_wait} <= named


def test_measured_tables_are_those_of_the_figures_that_were_measured() -> None:
    found = [(guide, name, text, in_guide(guide, name)) for guide, name, text in tables(read_figures())]
    assert len(found) > 5
    assert [(guide, name) for guide, name, text, place in found if place is None or place[1] != text] == []
    marks = [
        mark for guide in GUIDES for mark in re.findall("^<!-- measured: (.+) -->$", guide.read_text(), re.M)
    ]
    assert sorted(marks) == sorted(name for _, name, _, _ in found)


def test_no_measured_figure_is_of_an_older_algorithm() -> None:
    """Measure again what changed: tests/benchmarks/figures.py."""
    figures = read_figures()
    assert figures.keys() == used_figures()
    older = {name for name, each in figures.items() if is_outdated(name.partition("/")[0], each["algorithm"])}
    assert older == set()
