"""Rendered images kept on disk: rendered by the first test process that needs them, read by all others and later runs.

What is kept is named by a digest of all that it is made of: the arguments, the code of the module that asks and of the
modules of support that it imports, the code of the pipeline that these import, and the locked packages. Comments do
not count, nor do files that it is not made of.
"""

import ast
import fcntl
import functools
import hashlib
import inspect
import pickle
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ParamSpec, TypeVar

from service.processing.compiled_code import code_digests

REPOSITORY = Path(__file__).parents[2]
FOLDER = REPOSITORY / ".cache" / "rendered"
MAX_BYTES = 800_000_000
"""What was not used for longest is removed beyond it."""
PACKAGES = REPOSITORY / "deploy" / "requirements-check.lock"

Parameters = ParamSpec("Parameters")
Rendered = TypeVar("Rendered")


def kept_rendered(render: Callable[Parameters, Rendered]) -> Callable[Parameters, Rendered]:
    """Decorate a function of a module of support that renders; its arguments are told apart by their `repr`.

    The result is pickled once and shared by all calls of a process: it must not be changed.
    """

    @functools.cache
    def read_or_render(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Rendered:
        path = FOLDER / f"{render.__name__}-{_digest(render, args, kwargs)}.pickle"
        FOLDER.mkdir(parents=True, exist_ok=True)
        with _locked(path.with_suffix(".lock")):
            try:
                with path.open("rb") as file:
                    rendered: Rendered = pickle.load(file)  # noqa: S301 - our own
                path.touch()  # the oldest are removed
            except FileNotFoundError:
                rendered = render(*args, **kwargs)
                _keep(path, rendered)
        return rendered

    return functools.wraps(render)(read_or_render)


def _keep(path: Path, rendered: object) -> None:
    with tempfile.NamedTemporaryFile(dir=FOLDER, prefix=".unfinished-", delete=False) as file:
        pickle.dump(rendered, file, protocol=pickle.HIGHEST_PROTOCOL)
    Path(file.name).replace(path)
    _remove_oldest()


def _remove_oldest() -> None:
    """Remove what was not used for longest beyond `MAX_BYTES`; a process that still wants it renders it again."""
    entries = []
    for path in FOLDER.iterdir():
        try:
            entries.append((path.stat(), path))
        except FileNotFoundError:  # another process is at it as well
            continue
    n_bytes = 0
    for stat, path in sorted(entries, key=lambda entry: entry[0].st_mtime, reverse=True):
        n_bytes += stat.st_size
        if n_bytes > MAX_BYTES:
            path.unlink(missing_ok=True)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Have other processes wait: two would render the same."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _digest(render: Callable[..., object], args: tuple[object, ...], kwargs: dict[str, object]) -> str:
    made_of = [render.__qualname__, repr(args), repr(sorted(kwargs.items())), _packages()]
    return hashlib.sha256("\n".join([*made_of, *_code(Path(inspect.getfile(render)))]).encode()).hexdigest()[
        :16
    ]


@functools.cache
def _packages() -> str:
    return hashlib.sha256(PACKAGES.read_bytes()).hexdigest()


@functools.cache
def _code(module: Path) -> tuple[str, ...]:
    """Return the code of a module of support and of those it imports, with digests of what they use of the pipeline."""
    pipeline = code_digests(FOLDER)
    found, left = {}, [module]
    while left:
        path = left.pop()
        tree = ast.parse(path.read_text())
        found[path.name] = ast.dump(tree)
        for name in sorted(_imported(tree)):
            of_support = module.parent / f"{name.removeprefix('support.')}.py"
            of_pipeline = name.removeprefix("pipeline.").replace(".", "/")
            for each in (f"{of_pipeline}.py", f"{of_pipeline}/__init__.py"):
                if name.startswith("pipeline.") and each in pipeline:
                    found[each] = pipeline[each]
            if name.startswith("support.") and of_support.name not in found and of_support.exists():
                left.append(of_support)
    return tuple(f"{name} {found[name]}" for name in sorted(found))


def _imported(tree: ast.Module) -> set[str]:
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{each.name}" for each in node.names)}
    return names
