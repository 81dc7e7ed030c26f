#!/usr/bin/env python3
"""Print the structure of the three packages: files at each root, rooms, floors, arrows, circles, lines.

    python tests/benchmarks/structure.py [CHECKOUT]

Root is the number of files there; a room is a module or package at the root; an arrow between two rooms stands for any
number of imports; a room's floor is one above the highest floor that it imports; a loop is a set of rooms, a circle a
set of modules that import each other.
"""

import argparse
import os
import sys
from pathlib import Path

import grimp
import networkx
from rich.console import Console
from rich.table import Table

PACKAGES = ("service", "drivers", "pipeline")


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


def main() -> None:
    """Print a row for each package."""
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
    Console(width=None if sys.stdout.isatty() else 100).print(table)


if __name__ == "__main__":
    main()
