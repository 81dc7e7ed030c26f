"""Selection of tests that a change can reach: by imports, names of files in the code, and commands that are started.

For a person at work, who wants an answer in seconds. It may miss what is found at run time alone; the gate of CI runs
everything.
"""

import ast
import subprocess
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

PACKAGES = ("pipeline", "drivers", "service", "deploy", "tests")
ROOTS = ("", "deploy/", "tests/")
"""Where Python looks for modules: `service.x`, `gate.x`, `support.x`."""
STARTS = {"stonefall": "service/commands/cli.py"}
"""Name of a program that tests start -> file that it begins with."""
PLUGIN = "tests/support/stores.py"
"""Fixtures that every test may ask for by name."""
REACHES_ALL = ("pyproject.toml", "deploy/requirements-check.lock", "tests/conftest.py")
"""A change of these can change any test."""


def reached(since: str) -> list[str]:
    """Return the files of tests that the changes since a commit can reach, uncommitted and new files included."""
    return reached_by(changed_files(since), sources())


def changed_files(since: str) -> list[str]:
    """Return the files that differ from a commit, and the links to them."""
    asked = (["diff", "--name-only", since], ["ls-files", "--others", "--exclude-standard"])
    found = {Path(line).resolve(): line for arguments in asked for line in _git(*arguments).splitlines()}
    links = (path for package in PACKAGES for path in Path(package).rglob("*.py") if path.is_symlink())
    return [*found.values(), *(path.as_posix() for path in links if path.resolve() in found)]


def sources() -> dict[str, str]:
    """Read all Python files; path -> text."""
    paths = (
        path
        for package in PACKAGES
        for path in Path(package).rglob("*.py")
        if "node_modules" not in path.parts
    )
    return {path.as_posix(): path.read_text(encoding="utf-8") for path in paths}


def reached_by(changed: Iterable[str], sources: Mapping[str, str]) -> list[str]:
    """Return the files of tests among `sources`, by path, that a change of the files `changed` can reach."""
    tests = sorted(path for path in sources if Path(path).name.startswith("test_"))
    changed = set(changed)
    if changed & set(REACHES_ALL):
        return tests
    names = {path: _names(text) for path, text in sources.items()}
    fixtures = _fixtures(sources.get(PLUGIN, ""))
    needs = {path: _needed(path, names[path], sources.keys(), fixtures) for path in sources}
    found = {
        path
        for path in sources
        if path in changed or any(_is_of(each, path) or _is_named(each, names[path]) for each in changed)
    }
    while more := {path for path, needed in needs.items() if path not in found and needed & found}:
        found |= more
    return [path for path in tests if path in found]


def _needed(path: str, names: frozenset[str], paths: Iterable[str], fixtures: frozenset[str]) -> set[str]:
    """Return the files that a file needs: what it imports or names as a module; of tests also what they are given."""
    needed = {
        f"{root}{name.replace('.', '/')}{end}"
        for name in names
        for root in ROOTS
        for end in (".py", "/__init__.py")
    }
    if path.startswith("tests/"):
        needed |= {STARTS[name] for name in names & STARTS.keys()}
        needed |= {f"{folder.as_posix()}/conftest.py" for folder in Path(path).parents[:-2]}
        needed |= {PLUGIN} if names & fixtures else set()
    return needed & set(paths)


@cache
def _names(text: str) -> frozenset[str]:
    """Collect imported modules and their members, short string constants, and names of arguments in parentheses."""
    names = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{each.name}" for each in node.names)}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and len(node.value) < 100:
            names.add(node.value)
        elif isinstance(node, ast.arg):
            names.add(f"({node.arg})")
    return frozenset(names)


def _fixtures(plugin: str) -> frozenset[str]:
    """Return the names under which the fixtures of a module are asked for, as `_names` has them."""
    functions = (
        node for node in ast.parse(plugin).body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    )
    return frozenset(f"({each.name})" for each in functions if each.decorator_list)


def _is_of(changed: str, path: str) -> bool:
    """True if a file that is not Python (template, page, SQL) lies in the package of a module."""
    if changed.endswith(".py") or changed.startswith("tests/"):
        return False
    folder, of_module = Path(changed).parent, Path(path).parent
    return folder == of_module or (Path(path).name == "__init__.py" and folder.is_relative_to(of_module))


def _is_named(changed: str, names: frozenset[str]) -> bool:
    """True if a file names the end of a path in a string constant."""
    parts = Path(changed).parts
    return any("/".join(parts[i:]) in names for i in range(len(parts)))


def _git(*arguments: str) -> str:
    return subprocess.run(["git", *arguments], check=True, capture_output=True, text=True).stdout  # noqa: S603, S607 - git of the user
