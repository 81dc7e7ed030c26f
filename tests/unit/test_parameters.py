"""Calls that fit in the head: parameters that belong together are one."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST = 7


def test_no_function_but_a_compiled_loop_takes_more_than_seven_parameters() -> None:
    assert list(long_calls()) == []


def long_calls() -> Iterator[str]:
    for path in sorted(
        each for name in ("pipeline", "drivers", "service") for each in (ROOT / name).rglob("*.py")
    ):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            is_compiled = any("compiled" in ast.unparse(each) for each in node.decorator_list)
            if sum(each.arg not in ("self", "cls") for each in given) > MOST and not is_compiled:
                yield f"{path.relative_to(ROOT)}:{node.lineno} {node.name}"
