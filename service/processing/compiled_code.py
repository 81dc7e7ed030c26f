"""The cache of compiled loops: a folder for every state of the code that they are compiled from.

numba's own cache only notices a change in the file of a function, not in what the function calls, and would go on
using that old code after an update. Here the code of a module counts together with that of all modules of the pipeline
that it imports, and nothing else: a changed comment or docstring, or another path, compiles nothing anew.
"""

import ast
import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from service.base.paths import user_cache

FOLDER = "NUMBA_CACHE_DIR"
LOCATORS = "NUMBA_CACHE_LOCATOR_CLASSES"
SOURCES = Path(__file__).parents[2] / "pipeline"


def isolate_numba_cache() -> None:
    """Let numba keep compiled code by the state of the sources, in this process and those it starts.

    Call it before numba is imported. Without `NUMBA_CACHE_DIR` the cache is beside the sources, or where these are read
    only in the user's cache. For a user without a home numba chooses a place of its own.
    """
    if FOLDER not in os.environ:
        try:
            folder = SOURCES / "__pycache__" if os.access(SOURCES, os.W_OK) else user_cache() / "numba"
        except RuntimeError:
            return
        os.environ[FOLDER] = str(folder)
    os.environ[LOCATORS] = f"{__name__}.CodeLocator"


class CodeLocator:
    """Cache folder of one function; numba makes a locator for each function that it compiles."""

    def __init__(self, folder: Path, digest: str) -> None:
        self._folder = folder
        self._digest = digest

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> "CodeLocator | None":
        """Return the locator of a function of the pipeline; None when nothing can be cached."""
        source = Path(file)
        if not source.is_relative_to(SOURCES):
            return None
        root = Path(os.environ[FOLDER])
        try:
            digest = code_digests(root)[source.relative_to(SOURCES).as_posix()]
            locator = cls(root / f"{source.stem}-{digest}", digest)
            locator.ensure_cache_path()
        except OSError:
            return None
        return locator

    def ensure_cache_path(self) -> None:
        """Create the folder; raise `OSError` when nothing can be written there."""
        self._folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=self._folder).close()

    def get_cache_path(self) -> str:
        """Return the folder of the function."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Return the digest that must be equal for compiled code to be used again."""
        return self._digest

    def get_disambiguator(self) -> str:
        """Return an empty text: no module has two functions of one name, and line numbers change with comments."""
        return ""


@cache
def code_digests(root: Path) -> Mapping[str, str]:
    """Return, by file of the pipeline, the digest of its code and of all code that it imports from the pipeline.

    Digests of the same bytes are read from `root` if they are there: to parse all files takes a second.
    """
    sources = {path.relative_to(SOURCES).as_posix(): path.read_bytes() for path in SOURCES.rglob("*.py")}
    state = hashlib.sha256(b"".join(name.encode() + sources[name] for name in sorted(sources)))
    kept = root / f"state-{state.hexdigest()[:16]}.json"
    try:
        digests: dict[str, str] = json.loads(kept.read_text())
    except (OSError, ValueError):
        digests = _digests({name: ast.parse(text) for name, text in sources.items()})
        root.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=root, delete=False) as file:
            json.dump(digests, file)
        Path(file.name).replace(kept)
    return digests


def _digests(trees: Mapping[str, ast.Module]) -> dict[str, str]:
    imports = {name: _imported(tree) & trees.keys() for name, tree in trees.items()}
    own = {name: hashlib.sha256(_code(tree).encode()).hexdigest() for name, tree in trees.items()}
    digests = {}
    for name in trees:
        reached, found = {name}, [name]
        while found:
            new = imports[found.pop()] - reached
            reached |= new
            found.extend(new)
        code = "".join(own[each] for each in sorted(reached))
        digests[name] = hashlib.sha256(code.encode()).hexdigest()[:16]
    return digests


def _code(tree: ast.Module) -> str:
    """Return the code without line numbers, comments and docstrings, also those of constants and attributes."""
    for node in ast.walk(tree):
        for block in ("body", "orelse", "finalbody"):
            if isinstance(statements := getattr(node, block, None), list):
                setattr(node, block, [each for each in statements if not _is_text(each)])
    return ast.dump(tree)


def _is_text(statement: ast.stmt) -> bool:
    match statement:
        case ast.Expr(value=ast.Constant(value=str())):
            return True
    return False


def _imported(tree: ast.Module) -> set[str]:
    """Return the files of the pipeline that a module may import, those of packages included."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{each.name}" for each in node.names)}
    paths = {
        name.removeprefix("pipeline.").replace(".", "/") for name in names if name.startswith("pipeline.")
    }
    return {f"{path}.py" for path in paths} | {f"{path}/__init__.py" for path in paths}
