#!/usr/bin/env python3
"""Print the structure of the three packages: rooms, floors, arrows, circles, lines; facts described twice, long calls.

    python tests/benchmarks/structure.py [CHECKOUT]

Root is the number of files there; a room is a module or package at the root; an arrow between two rooms stands for any
number of imports; a room's floor is one above the highest floor that it imports; a loop is a set of rooms, a circle a
set of modules that import each other. Two classes of different files are mirrored if they share 70 % of the fields of
the one that has more; a call is long with eight parameters or more, compiled loops apart; a first line is dark if what,
whether, how or why is what a function returns.
"""

import argparse
import ast
import os
import re
import sys
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import grimp
import networkx
from rich.console import Console
from rich.table import Table

PACKAGES = ("service", "drivers", "pipeline")
Function = ast.FunctionDef | ast.AsyncFunctionDef
MIRRORED_SHARE, LEAST_FIELDS = 0.7, 3
MOST_PARAMETERS = 7
DARK = re.compile(r"(Return|Yield|Tell|Say)\w* (what|whether|how|why|which|who)\b", re.IGNORECASE)


def circles(graph: "networkx.DiGraph[str]") -> int:
    """Count the sets of nodes that reach each other."""
    return sum(len(component) > 1 for component in networkx.strongly_connected_components(graph))


def rooms_of(modules: "networkx.DiGraph[str]") -> "networkx.DiGraph[str]":
    """Draw the modules together by the first two parts of their names."""
    names = {name: ".".join(name.split(".")[:2]) for name in modules}
    rooms = networkx.DiGraph()
    rooms.add_nodes_from(room for name, room in names.items() if "." in name)
    rooms.add_edges_from(
        (names[importer], names[imported])
        for importer, imported in modules.edges
        if names[importer] != names[imported] and "." in importer and "." in imported
    )
    return rooms


def fields_of(node: ast.ClassDef) -> set[str]:
    """Return the names of the annotated fields of a class."""
    return {
        each.target.id
        for each in node.body
        if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name)
    }


def is_long(node: Function) -> bool:
    """True for a function of more than seven parameters that is no compiled loop."""
    arguments = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
    is_compiled = any(
        "compiled" in ast.unparse(each) or "jit" in ast.unparse(each) for each in node.decorator_list
    )
    return not is_compiled and sum(each.arg not in ("self", "cls") for each in arguments) > MOST_PARAMETERS


def nodes_of(package: str) -> Iterator[tuple[Path, ast.AST]]:
    """Yield all nodes of a package with the file that each is in."""
    for path in sorted(Path(package).rglob("*.py")):
        yield from ((path, node) for node in ast.walk(ast.parse(path.read_text())))


def table_of_words() -> Table:
    """Return the counts over all packages: what is described twice, long calls, dark first lines."""
    nodes = [each for package in PACKAGES for each in nodes_of(package)]
    classes = [
        (path, found)
        for path, node in nodes
        if isinstance(node, ast.ClassDef)
        if len(found := fields_of(node)) >= LEAST_FIELDS
    ]
    mirrored = sum(
        one[0] != other[0] and len(one[1] & other[1]) >= MIRRORED_SHARE * max(len(one[1]), len(other[1]))
        for one, other in combinations(classes, 2)
    )
    functions = [node for _, node in nodes if isinstance(node, Function)]
    documented = [node for _, node in nodes if isinstance(node, Function | ast.ClassDef | ast.Module)]
    dark = sum(DARK.match(ast.get_docstring(node) or "") is not None for node in documented)
    table = Table("mirrored pairs of classes", "long calls", "dark first lines")
    table.add_row(str(mirrored), str(sum(map(is_long, functions))), str(dark))
    return table


def main() -> None:
    """Print a row for each package, and the counts over all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkout", type=Path, nargs="?", default=Path(__file__).parents[2])
    checkout = parser.parse_args().checkout.resolve()
    os.chdir(checkout)
    sys.path.insert(0, str(checkout))
    table = Table("package", "root", "rooms", "floors", "arrows", "imports", "loops", "circles", "lines")
    for package in PACKAGES:
        graph = grimp.build_graph(package, cache_dir=None)
        modules: networkx.DiGraph[str] = networkx.DiGraph()
        modules.add_nodes_from(graph.modules)
        modules.add_edges_from(
            (name, imported)
            for name in graph.modules
            for imported in graph.find_modules_directly_imported_by(name)
        )
        rooms = rooms_of(modules)
        sources = list(Path(package).rglob("*.py"))
        row = (
            len(list(Path(package).glob("*.py"))),
            len(rooms),
            networkx.dag_longest_path_length(networkx.condensation(rooms)) + 1,
            rooms.number_of_edges(),
            modules.number_of_edges(),
            circles(rooms),
            circles(modules),
            sum(len(path.read_text().splitlines()) for path in sources),
        )
        table.add_row(package, *map(str, row))
    Console(width=None if sys.stdout.isatty() else 100).print(table, table_of_words())


if __name__ == "__main__":
    main()
