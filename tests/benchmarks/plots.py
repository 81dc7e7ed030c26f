"""Draw the plots of tests/benchmarks/README.md from the JSON output of the benchmarks, one plot a file.

Run: .venv/bin/pip install --require-hashes -r deploy/requirements-benchmark.lock
     .venv/bin/stonefall benchmark --poses 5 --json > stages.json
     .venv/bin/stonefall benchmark --scaling --poses 2 --json > scaling.json
     .venv/bin/python tests/benchmarks/carving.py --out peers.json
     .venv/bin/python tests/benchmarks/sustained.py --rates 4,10 --seconds 60 --queue 150 --out latency.json
     .venv/bin/python tests/accuracy/uncertainty.py --out uncertainty.json
     .venv/bin/python tests/benchmarks/plots.py stages.json scaling.json peers.json latency.json uncertainty.json

The name of a file decides what is drawn; its plot has the same name.
"""

import argparse
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

FOLDER = Path(__file__).parent / "plots"
SIZE_INCH = (7.0, 3.2)
STYLE = {
    "font.size": 9,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "stonefall",  # the same figures, the same file
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}
PUBLISHED_MS = 3800.0
"""Segmentation and reconstruction of a stone as published, on a PC with a GPU."""
BAR_MS = 500.0
"""Goal for the 99th percentile of the time from exposure to durable result."""


def draw_stages(axes: Axes, rows: list[dict[str, Any]]) -> None:
    """Draw the processor time of a stone of each size, stage upon stage."""
    sizes = [f"{row['size_mm']:g} mm" for row in rows]
    below = np.zeros(len(rows))
    for stage in rows[0]["stages_ms"]:
        cost_ms = np.array([row["stages_ms"][stage] for row in rows])
        axes.barh(sizes, cost_ms, left=below, label=stage)
        below += cost_ms
    for size, row, end in zip(sizes, rows, below, strict=True):
        axes.text(end, size, f"  {row['cpu_ms']:.0f}", va="center")
    axes.invert_yaxis()
    axes.set_xlabel(
        f"ms of processor time a stone, 16 images to all measures (published: {PUBLISHED_MS:.0f})"
    )
    axes.legend(ncols=2, loc="upper right")


def draw_scaling(axes: Axes, document: dict[str, Any]) -> None:
    """Draw the processor time from silhouettes to mesh against the voxels along an edge."""
    n = np.array([grid["n"] for grid in document["grids"]])
    for stage, exponent in document["exponents"].items():
        cost_ms = np.array([grid["stages_ms"][stage] for grid in document["grids"]])
        axes.loglog(n, cost_ms, "o-", label=f"{stage}: n^{exponent:.2f}")
    first_ms = document["grids"][0]["stages_ms"]["sum"]
    for power, style in ((2, ":"), (3, "--")):
        axes.loglog(n, first_ms * (n / n[0]) ** power, f"k{style}", lw=0.8, label=f"n^{power}")
    axes.set_xticks(n, [f"{edge}³" for edge in n])
    axes.minorticks_off()
    axes.set_xlabel("voxels")
    axes.set_ylabel("ms of processor time")
    axes.legend(loc="upper left")


def draw_peers(axes: Axes, rows: list[dict[str, Any]]) -> None:
    """Draw the processor time of other libraries on the same silhouettes, as multiples of ours."""
    peers = [row for row in rows if row["what"] != "ours" and row["ratio"]]
    stages = list(dict.fromkeys(row["stage"] for row in peers))
    for number, stage in enumerate(stages):
        of_stage = [row for row in peers if row["stage"] == stage]
        labels = [f"{stage}: {row['what']}" for row in of_stage]
        bars = axes.barh(labels, [row["ratio"] for row in of_stage], color=f"C{number}")
        axes.bar_label(bars, fmt="%.0f", padding=3)
    axes.set_xscale("log")
    axes.set_xlim(1, 3 * max(row["ratio"] for row in peers))
    axes.invert_yaxis()
    axes.set_xlabel("times as long as ours")


def draw_latency(axes: Axes, runs: list[dict[str, Any]]) -> None:
    """Draw the share of results that are durable against the time since the exposure."""
    for run in runs:
        latency_ms = np.sort(run["latency_ms"])
        share = np.arange(1, len(latency_ms) + 1) / len(latency_ms)
        axes.semilogx(latency_ms, 100 * share, label=f"{run['name']}: {len(latency_ms)} stones")
    axes.axvline(BAR_MS, color="k", lw=0.8, ls=":")
    axes.axhline(99, color="k", lw=0.8, ls=":")
    axes.set_xlabel("ms from the exposure to the durable result")
    axes.set_ylabel("% of the stones")
    axes.legend()


def draw_uncertainty(axes: Axes, rows: list[dict[str, Any]]) -> None:
    """Draw the share of stones against error / sigma, of surface and volume, beside that of a normal error."""
    stones = [row for row in rows if row["condition"] != "ideal" and row["error_mm"] is not None]
    share = 100 * np.arange(1, len(stones) + 1) / len(stones)
    for label, error, sd in (
        ("mean distance of the surface", "error_mm", "surface_sd_mm"),
        ("volume", "volume_error_percent", "volume_sd_percent"),
    ):
        axes.plot(np.sort([abs(row[error]) / row[sd] for row in stones]), share, label=label)
    sigmas = np.linspace(0, 4, 81)
    axes.plot(sigmas, [100 * math.erf(x / math.sqrt(2)) for x in sigmas], "k:", lw=0.8, label="normal")
    axes.axvline(3, color="k", lw=0.8)
    axes.set_xlim(0, 4)
    axes.set_xlabel(
        f"error / sigma, {len(stones)} stones under {len({row['condition'] for row in stones})} conditions"
    )
    axes.set_ylabel("% of the stones")
    axes.legend(loc="lower right")


DRAWN: dict[str, Callable[[Axes, Any], None]] = {
    "stages": draw_stages,
    "scaling": draw_scaling,
    "peers": draw_peers,
    "latency": draw_latency,
    "uncertainty": draw_uncertainty,
}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("documents", type=Path, nargs="+", help=f"{', '.join(DRAWN)}: NAME.json")
    parser.add_argument("--out", type=Path, default=FOLDER)
    arguments = parser.parse_args()
    if unknown := [str(path) for path in arguments.documents if path.stem not in DRAWN]:
        parser.error(f"{unknown[0]}: its name is none of {', '.join(DRAWN)}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        for path in arguments.documents:
            figure = Figure(figsize=SIZE_INCH, layout="constrained")
            DRAWN[path.stem](figure.subplots(), json.loads(path.read_text()))
            figure.savefig(arguments.out / f"{path.stem}.svg", metadata={"Date": None})
    return 0


if __name__ == "__main__":
    sys.exit(main())
