"""One source of measured figures: what was measured by which command, and the tables of the guides made from it.

    .venv/bin/python tests/benchmarks/figures.py accuracy paper    measures these again, and writes tables and figures
    .venv/bin/python tests/benchmarks/figures.py                   writes the tables alone

`figures.json` has every figure with its command, body, lens, algorithm, date and the processor's speed; `figures.md`
every table as a guide has it, with `{figure:format}` in the place of each figure; of a cell that a command printed,
`{figure:}` is all of it and `{figure:1}` its second number. A test compares the guides.
"""

import argparse
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import takewhile
from pathlib import Path
from typing import Any

from service.results.version import ALGORITHM_VERSION, CHANGES

ROOT = Path(__file__).parents[2]
FIGURES, TABLES = ROOT / "tests/benchmarks/figures.json", ROOT / "tests/benchmarks/figures.md"
PLACE = re.compile(r"\{([^{}:]+):([^{}]*)\}")
"""A figure in a table: its name, and how Python formats it or which number of a cell it is."""
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
TABLE = re.compile(r"^## (?P<guide>\S+): (?P<name>.+)\n\n(?P<text>(?:.+\n)+)", re.MULTILINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A command that prints JSON, and how its figures are called."""

    command: str
    figures_of: Callable[[Any], Iterator[tuple[str, float | str]]]
    lens: str | None = None
    body: str | None = None


def of_bodies(document: Any) -> Iterator[tuple[str, float]]:
    """Yield the figures of `stonefall benchmark --accuracy`: body, rig, method and field."""
    for summary in document["summaries"]:
        where = f"{summary['body']}/{summary['rig']}/{summary['method']}"
        yield from ((f"{where}/{name}", value) for name, value in summary.items() if _is_figure(value))


def of_paper(document: Any) -> Iterator[tuple[str, float]]:
    """Yield the figures of `stonefall benchmark --paper`."""
    for row in document["distances"]:
        yield from ((f"{row['body']}/{name}", value) for name, value in row.items() if _is_figure(value))
    for row in document["isolevels"]:
        yield f"{row['body']}/{row['isolevel']:g}/mean_mm", row["mean_mm"]
        yield f"{row['body']}/{row['isolevel']:g}/volume_percent", row["mesh_volume_percent"]
    for method, seconds in document["seconds"].items():
        yield from ((f"{method}/{stage}_s", value) for stage, value in seconds.items())


def of_drops(document: Any) -> Iterator[tuple[str, float]]:
    """Yield the figures of `tests/accuracy/calibration.py`: how it was calibrated, and what of it."""
    for row in document:
        how = row["calibration"].split(",")
        where = f"{how[0]}{how[1].removesuffix(' drops').replace(' ', '/')}"
        yield from ((f"{where}/{name}", value) for name, value in row.items() if _is_figure(value))


def of_sizes(document: Any) -> Iterator[tuple[str, float]]:
    """Yield the times of `stonefall benchmark`: size, stage and milliseconds."""
    for row in document:
        where = f"{row['size_mm']:g}"
        yield from ((f"{where}/{stage}", ms) for stage, ms in row["stages_ms"].items())
        yield from ((f"{where}/{name}", value) for name, value in row.items() if _is_figure(value))


def of_scaling(document: Any) -> Iterator[tuple[str, float]]:
    """Yield the figures of `stonefall benchmark --scaling`."""
    yield from ((f"grows/{name}", value) for name, value in document["exponents"].items())
    yield from ((f"{row['n_views']} views", sum(row["stages_ms"].values())) for row in document["views"])
    yield from ((f"{row['n_workers']} workers", row["stones_per_s"]) for row in document["workers"])


NAMES = {
    "",
    "body",
    "by",
    "case",
    "condition",
    "fields",
    "goal",
    "lens",
    "measured again by",
    "segmenter",
    "stage",
}
NAMES |= {
    "rig",
    "kind",
    "object",
    "all turns of",
    "start mm",
    "rate",
    "form",
    "healthy stones",
    "cameras",
    "indices",
    "recalibrated after turns of",
}
"""Headings of columns that name a row, where they are a table's first ones."""


def of_cells(document: Any) -> Iterator[tuple[str, str]]:
    """Yield the cells that `support.printed.show` printed, by the row's name and the heading up to a colon."""
    named: dict[str, str] = {}
    for row in document:
        names = list(takewhile(NAMES.__contains__, row))
        named = {name: row[name].replace(":", "") or named[name] for name in names}
        where = "/".join([*named.values(), ""])
        yield from ((where + heading.partition(":")[0], row[heading]) for heading in row.keys() - names)


RUNS: Mapping[str, Run] = {
    "accuracy": Run(
        command="stonefall benchmark --accuracy --rigs ours --bodies sphere,cylinder,cube,stones --json",
        figures_of=of_bodies,
        lens="f2",
        body="as named",
    ),
    "paper": Run(command="stonefall benchmark --paper --json", figures_of=of_paper, lens="f2", body="photo"),
    **{
        f"drops-{name}": Run(
            command=f"tests/accuracy/calibration.py --rigs 1 --seed 3 --lens {lens} --json",
            figures_of=of_drops,
            lens=lens.partition(" ")[0],
        )
        for name, lens in (
            *((lens, lens) for lens in ("sharp", "f8", "f4", "f2")),
            ("spotted", "f2 --wall spotted"),
        )
    },
    "times": Run(command="stonefall benchmark --poses 5 --json", figures_of=of_sizes, body="as named"),
    "scaling": Run(command="stonefall benchmark --scaling --poses 2 --json", figures_of=of_scaling),
    **{
        f"refined-{lens}": Run(
            command="stonefall benchmark --accuracy --bodies sphere,cylinder,cube,stones,dented --poses 3"
            f" --rigs true --seed 2 --lens {lens} --json",
            figures_of=of_bodies,
            lens=lens,
            body="as named",
        )
        for lens in ("f8", "f2")
    },
    "concave": Run(
        command="stonefall benchmark --accuracy --rigs ours"
        " --bodies dented,tromino,horseshoe,two-lobed,rough,splinter --lens sharp --json",
        figures_of=of_bodies,
        lens="sharp",
        body="as named",
    ),
    **{
        name: Run(command=f"tests/{command} --json", figures_of=of_cells, lens=lens, body=body)
        for name, command, lens, body in (
            ("segmentation", "benchmarks/segmentation.py --views 5 --seed 42000", "as named", None),
            ("peers", "benchmarks/carving.py", "sharp", "hull"),
            (
                "sustained",
                "benchmarks/sustained.py --rates 4,10 --seconds 30 --queue 150 --body estimate",
                "sharp",
                "estimate",
            ),
            ("refined-load", "benchmarks/sustained.py --rates 4,10 --seconds 30 --burst 0", "sharp", "photo"),
            ("live", "benchmarks/live.py --seconds 40", "sharp", "photo"),
            ("live-network", "benchmarks/live.py --seconds 30 --segmenter onnx", "sharp", "photo"),
            ("receiving", "benchmarks/live.py --receiving --rate 1 --seconds 15", None, None),
            ("deaths", "benchmarks/camera_deaths.py --deaths 5", "sharp", "hull"),
            (
                "readers",
                "benchmarks/readers.py --seconds 25 --phases calm,polls,calm,pages,calm,cheap,calm,rude,calm,viewers",
                "sharp",
                "photo",
            ),
            (
                "lots",
                "benchmarks/readers.py --seconds 25 --before 10000 --phases calm,lots",
                "sharp",
                "photo",
            ),
            ("pull", "benchmarks/pull.py", None, None),
            ("priorities", "benchmarks/priorities.py", "sharp", "as named"),
            ("start", "benchmarks/start.py", None, None),
            ("cluster", "benchmarks/cluster.py --by 1 2", "sharp", "photo"),
            ("uncertainty", "accuracy/uncertainty.py --seed 2", "as named", "photo"),
            ("refinement", "accuracy/refinement.py", "f2", "photo"),
            ("refinement-8", "accuracy/refinement.py --bodies dented --size-mm 8", "f2", "photo"),
            ("surfaces", "accuracy/surfaces.py --seed 113 --count 1", "as named", "photo"),
            ("feed", "accuracy/feed_rates.py --seconds 20 --rendered 24", "f2", "photo"),
            ("bumps", "accuracy/bumps.py --recalibrate", "sharp", None),
            ("bumps-f2", "accuracy/bumps.py --lens f2 --turns 0.01 0.1 --recalibrate", "f2", None),
            (
                "bumps-spotted",
                "accuracy/bumps.py --lens f2 --wall spotted --turns 0.1 --recalibrate",
                "f2",
                None,
            ),
            ("gradation", "accuracy/gradation.py --seed 1", "f2", "photo"),
            ("rock", "accuracy/rock.py", "f2", "photo"),
        )
    },
}


OF_SERVICE = frozenset(
    {"peers", "deaths", "receiving", "readers", "lots", "pull", "priorities", "start", "cluster"}
)
"""Runs that measure carving, or what the service does beside measuring: a new algorithm does not outdate them."""
LEFT_BY = {
    "20": frozenset(
        name
        for name in RUNS
        if name.startswith(("drops", "bumps", "live"))
        or name
        in {
            "paper",
            "concave",
            "segmentation",
            "times",
            "scaling",
            "sustained",
            "refined-load",
            "refinement-8",
        }
    ),
    "21": frozenset(
        name for name in RUNS if name.startswith(("drops", "bumps")) or name in {"segmentation", "sustained"}
    ),
    "22": frozenset(RUNS) - {"uncertainty", "rock", "times"},
}
"""Runs without a figure that a version of the algorithm changed.

20 is another coefficient of the corrected volume; 21 changes refined bodies alone; 22 words of
quality and the time for them.
"""


def is_outdated(run: str, version: str) -> bool:
    """Whether a later version of the algorithm than `version` may have changed the figures of a run."""
    return run not in OF_SERVICE and any(
        int(later) > int(version) and run not in LEFT_BY.get(later, ()) for later in CHANGES
    )


def measure(name: str) -> dict[str, dict[str, Any]]:
    """Run a command, and return its figures by name with where they are from."""
    from research.performance import processor_gflops

    run = RUNS[name]
    words = shlex.split(run.command)
    program = [sys.executable] if words[0].endswith(".py") else [Path(sys.executable).with_name(words.pop(0))]
    answer = subprocess.run([*program, *words], check=False, stdout=subprocess.PIPE, cwd=ROOT)
    source = {
        "command": run.command,
        "body": run.body,
        "lens": run.lens,
        "algorithm": ALGORITHM_VERSION,
        "date": datetime.now(UTC).date().isoformat(),
        "gflops": round(processor_gflops(), 1),
    }
    return {
        f"{name}/{figure}": {"value": value, **source}
        for figure, value in run.figures_of(json.loads(answer.stdout))
    }


def read_figures() -> dict[str, dict[str, Any]]:
    """Return all figures by name."""
    return dict(json.loads(FIGURES.read_text(encoding="utf-8"))) if FIGURES.exists() else {}


def used_figures() -> set[str]:
    """Return the names of the figures that a table has."""
    return {match[1] for match in PLACE.finditer(TABLES.read_text(encoding="utf-8"))}


def tables(figures: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[Path, str, str]]:
    """Yield guide, name and text of each table; `KeyError` for a figure that was never measured."""

    def written(place: re.Match[str]) -> str:
        value = figures[place[1]]["value"]
        if isinstance(value, str):
            return NUMBER.findall(value)[int(place[2])] if place[2] else value
        return format(value, place[2])

    for match in TABLE.finditer(TABLES.read_text(encoding="utf-8")):
        yield ROOT / match["guide"], match["name"], PLACE.sub(written, match["text"])


def in_guide(guide: Path, name: str) -> re.Match[str] | None:
    """Find a table between its marks in a guide."""
    begin, end = f"<!-- measured: {name} -->\n", "<!-- measured -->"
    pattern = re.escape(begin) + "(.*?)" + re.escape(end)
    return re.search(pattern, guide.read_text(encoding="utf-8"), re.DOTALL)


def _is_figure(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def main() -> None:
    """Measure what is named, and write figures and tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="*", choices=[[], *RUNS], metavar="RUN", help=", ".join(RUNS))
    figures = read_figures()
    for name in parser.parse_args().runs:
        others = {figure: found for figure, found in figures.items() if not figure.startswith(f"{name}/")}
        figures = others | measure(name)
    used = used_figures()
    kept = {name: figures[name] for name in sorted(figures) if name in used}
    FIGURES.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    for guide, name, text in tables(kept):
        found = in_guide(guide, name)
        if found is None:
            raise SystemExit(f"{guide.relative_to(ROOT)} has no place for the table {name!r}")
        whole = guide.read_text(encoding="utf-8")
        guide.write_text(whole[: found.start(1)] + text + whole[found.end(1) :], encoding="utf-8")


if __name__ == "__main__":
    main()
