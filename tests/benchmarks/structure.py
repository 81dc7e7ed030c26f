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
from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import grimp
import networkx
from rich.console import Console
from rich.table import Table

PACKAGES = ("service", "drivers", "pipeline")
ROOT = Path(__file__).parents[2]
Documented = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module
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


Nodes = Sequence[tuple[Path, ast.AST]]


def nodes_of(checkout: Path) -> Nodes:
    """Return all nodes of the packages with the file that each is in; a link is no file of theirs."""
    paths = [path for package in PACKAGES for path in sorted((checkout / package).rglob("*.py"))]
    own = (path for path in paths if not path.is_symlink())
    return [(path, node) for path in own for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))]


def mirrored_pairs(nodes: Nodes) -> list[tuple[str, str]]:
    """Return pairs of classes of different files that share most of their fields."""
    classes = [
        (path, node.name, fields)
        for path, node in nodes
        if isinstance(node, ast.ClassDef) and len(fields := _fields_of(node)) >= LEAST_FIELDS
    ]
    return [
        (one, other)
        for (here, one, fields), (there, other, others) in combinations(classes, 2)
        if here != there and len(fields & others) >= MIRRORED_SHARE * max(len(fields), len(others))
    ]


def shared_names(nodes: Nodes) -> list[str]:
    """Return the names that public classes of different files share."""
    homes = Counter(
        node.name
        for _, module in nodes
        if isinstance(module, ast.Module)
        for node in module.body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    return [name for name, n_homes in homes.items() if n_homes > 1]


def long_calls(nodes: Nodes) -> list[str]:
    """Return the functions of more than seven parameters that are no compiled loops."""
    functions = (node for _, node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    return [node.name for node in functions if _is_long(node)]


def dark_lines(nodes: Nodes) -> list[str]:
    """Return the first lines that name no result: "Return what ..."."""
    documented = (node for _, node in nodes if isinstance(node, Documented))
    return [text for node in documented if DARK.match(text := ast.get_docstring(node) or "")]


def _fields_of(node: ast.ClassDef) -> set[str]:
    annotated = (each for each in node.body if isinstance(each, ast.AnnAssign))
    return {each.target.id for each in annotated if isinstance(each.target, ast.Name)}


def _is_long(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    arguments = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
    is_compiled = any("compiled" in ast.unparse(each) for each in node.decorator_list)
    return not is_compiled and sum(each.arg not in ("self", "cls") for each in arguments) > MOST_PARAMETERS


def table_of_words(checkout: Path) -> Table:
    """Return the counts over all packages: what is described twice, long calls, dark first lines."""
    nodes = nodes_of(checkout)
    counts = {
        "mirrored pairs of classes": mirrored_pairs(nodes),
        "names of classes with several homes": shared_names(nodes),
        "long calls": long_calls(nodes),
        "dark first lines": dark_lines(nodes),
    }
    table = Table(*counts)
    table.add_row(*(str(len(found)) for found in counts.values()))
    return table


def main() -> None:
    """Print a row for each package, and the counts over all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkout", type=Path, nargs="?", default=ROOT)
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
    Console(width=None if sys.stdout.isatty() else 100).print(table, table_of_words(checkout))


if __name__ == "__main__":
    main()
