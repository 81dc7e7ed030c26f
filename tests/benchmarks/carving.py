"""Time carving, meshing and integrating of one stone, against other libraries on the same silhouettes.

Run: .venv/bin/python tests/benchmarks/carving.py [--size-mm 25] [--seed 1] [--n 256] [--repeat 9]
     [--peers numpy,slabs,opencv,open3d,skimage,pymcubes,trimesh] [--json]
Peers to install first: .venv/bin/pip install --require-hashes -r deploy/requirements-benchmark.lock

Processor milliseconds on one thread, medians. Each peer runs in a process of its own, and our code is timed before and
after it, so that a machine whose speed varies does not change a ratio. All use the rig as designed, since not every
peer models lens distortion. Exits with 1 if a hull of the same definition differs from ours.
"""

import argparse
import ctypes
import json
import multiprocessing
import os
import re
import sys
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import mean, median
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.ndimage import binary_erosion
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.carving_peers import ALL, CARVE, CARVE_FINE, INTEGRATE, MESH, PEERS, Task, Work, voxels_of
from support.printed import show

from pipeline.carving import CarvingParameters, VisualHull, carve
from pipeline.measuring.solid import Solid, solid_of
from pipeline.meshing import ParticleMesh, mesh_hull
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import nominal_rig
from pipeline.segmentation import BackgroundModel, SilhouetteSet, segment_all
from pipeline.segmentation.background import learn_background
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bundles import render_bundle, render_empty, stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.renderer import simulate_rig
from pipeline.synthesis.stones import stone
from pipeline.views.prepared import prepare_views

N_EMPTY = 4
ENOUGH_S = 5.0
"""Processor time after which a peer is not repeated."""
MAX_DIFFERING = 2e-4
"""Accepted share of the surface voxels: projections in single and in double precision round some half pixels apart."""
WIDTH = 150
"""Width of a table that is written into a file, in characters."""


# --- one peer, in a process of its own ---


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cost:
    """Cost of one way, and its result."""

    cpu_ms: float
    peak_mib: float  # above what imports and inputs take
    hull: NDArray[np.uint8] | None = None  # packed bits of (n, n, n)
    mesh_mm3: float | None = None
    n_faces: int | None = None


def cost_of(name: str, task: Task, repeat: int) -> Cost | None:
    """Time a peer, to be called in a process of its own; return None if the peer is not installed."""
    use_one_thread()
    try:
        work = PEERS[name].work(task)
    except ImportError:
        return None
    cpu_ms, peak_mib, answer = timed(work, repeat)
    if PEERS[name].stage == CARVE:
        hull = np.packbits(voxels_of(answer, task.n))
        return Cost(cpu_ms=cpu_ms, peak_mib=peak_mib, hull=hull)
    mesh = trimesh.Trimesh(*answer, process=False)
    volume_mm3 = abs(float(mesh.volume)) * task.pitch_mm**3
    return Cost(cpu_ms=cpu_ms, peak_mib=peak_mib, mesh_mm3=volume_mm3, n_faces=len(mesh.faces))


def use_one_thread() -> None:
    cv2.setNumThreads(1)
    threadpool_limits(1)


def timed(work: Work, repeat: int) -> tuple[float, float, Any]:
    """Return median CPU ms (the first run counts only if slow), peak MiB above the level before, and the result."""
    ctypes.CDLL(None).malloc_trim(0)  # else reused memory of the last run would not be seen
    Path("/proc/self/clear_refs").write_text("5")  # resets the peak
    before_mib = memory_mib("VmRSS")
    times_s: list[float] = []
    answer = None
    while len(times_s) <= repeat and sum(times_s) < ENOUGH_S:
        start_s = time.process_time()
        answer = work()
        times_s.append(time.process_time() - start_s)
    return 1000 * median(times_s[1:] or times_s), memory_mib("VmHWM") - before_mib, answer


def memory_mib(name: str) -> float:
    found = re.search(rf"{name}:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) / 1024


# --- our code, in this process ---


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stone:
    """One stone as the rig sees it."""

    rig: RigCalibration
    silhouettes: SilhouetteSet


def photographed(size_mm: float, seed: int) -> Stone:
    """Render a stone with every lens as designed, so without distortion, and segment its views."""
    rig = nominal_rig()
    simulated = simulate_rig(rig, stream(seed, 0))
    background: BackgroundModel = {}
    for number in range(N_EMPTY):
        empty = render_empty(simulated, stream(seed, 1, number), sequence=number + 1)
        background = learn_background(background, empty.frames)
    rng = stream(seed, 2)
    bundle = render_bundle([tumble(stone("angular", size_mm, rng), rig, rng)], simulated, rng, sequence=1)
    return Stone(rig=rig, silhouettes=segment_all(bundle.frames, background, BackgroundSegmenter()))


def task_of(seen: Stone, n: int) -> Task:
    hull = carve(prepare_views(seen.silhouettes, seen.rig), CarvingParameters(n=n, field="view_count"))
    parameters = CarvingParameters(n=n)
    low = np.rint(hull.origin_mm / parameters.pitch_mm + (n - 1) / 2).astype(int)
    count = np.zeros((n + 2,) * 3, np.float32)  # the hull's box may reach one voxel beyond the grid
    count[tuple(slice(a + 1, a + 1 + edge) for a, edge in zip(low, hull.field.shape, strict=True))] = (
        hull.field
    )
    cameras = seen.rig.cameras
    return Task(
        masks=np.stack(
            [(seen.silhouettes[camera.id].label_image() > 0).astype(np.uint8) for camera in cameras]
        ),
        K=np.stack([camera.K for camera in cameras]),
        pose=np.stack([np.column_stack([camera.R, camera.t_mm]) for camera in cameras]),
        n=n,
        size_mm=parameters.size_mm,
        count=np.ascontiguousarray(count[1:-1, 1:-1, 1:-1]),
    )


def our_work(seen: Stone, n: int) -> Mapping[str, Work]:
    """Return our function for each stage; lazily computed properties are computed anew in each call."""

    def carved(field: Any) -> VisualHull:
        fresh = {camera: replace(silhouette) for camera, silhouette in seen.silhouettes.items()}
        return carve(prepare_views(fresh, seen.rig), CarvingParameters(n=n, field=field))

    def meshed(hull: VisualHull) -> ParticleMesh:
        mesh = mesh_hull(hull)
        assert mesh is not None
        return mesh

    def integrated(mesh: ParticleMesh) -> Solid:
        return solid_of(mesh.vertices_mm, mesh.faces)

    counted = carved("view_count")
    mesh = meshed(counted)
    return {
        CARVE: lambda: carved("view_count"),
        CARVE_FINE: lambda: carved("sub_voxel"),
        MESH: lambda: meshed(counted),
        INTEGRATE: lambda: integrated(mesh),
        ALL: lambda: integrated(meshed(carved("sub_voxel"))),
    }


# --- the table ---


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    stage: str
    what: str
    cpu_ms: float | None = None  # None: not installed
    ratio: float | None = None  # to our time, in the same minute
    ratio_fine: float | None = None  # to our sub-voxel carving, distances to edges included
    peak_mib: float | None = None
    n_voxels: int | None = None
    differing: float | None = None  # voxels that differ from ours, as a share of the surface's
    is_same_hull: bool = False
    mesh_mm3: float | None = None
    n_faces: int | None = None


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size-mm", type=float, default=25)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--n", type=int, default=256, help="voxels an edge")
    parser.add_argument("--repeat", type=int, default=9)
    parser.add_argument("--peers", default=",".join(PEERS), help="empty: our code alone")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path, help="JSON of all rows, which tests/benchmarks/plots.py draws")
    arguments = parser.parse_args()
    os.environ["OMP_NUM_THREADS"] = "1"  # in the peers' processes
    use_one_thread()
    seen = photographed(arguments.size_mm, arguments.seed)
    task = task_of(seen, arguments.n)
    names = [name for name in PEERS if name in arguments.peers.split(",")]
    rows = compared(seen, task, names, arguments.repeat)
    if arguments.out is not None:
        arguments.out.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    title = (
        f"CPU ms of a stone of {arguments.size_mm:g} mm, {len(task.masks)} views, {task.n}^3 voxels, seed"
        f" {arguments.seed}; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    )
    show(table_of(rows, title), as_json=arguments.json, width=WIDTH)
    differing = [row for row in rows if row.is_same_hull and (row.differing or 0) > MAX_DIFFERING]
    for row in differing:
        Console(stderr=True).print(f"FAILED: the hull of {row.what} differs from ours")
    return int(bool(differing))


def compared(seen: Stone, task: Task, names: list[str], repeat: int) -> list[Row]:
    """Time our code, then each peer between two runs of our code."""
    ours = our_work(seen, task.n)
    inside = task.count > task.level
    n_surface = int((inside & ~binary_erosion(inside)).sum())
    mesh = ours[MESH]()
    rows = []
    for stage, work in ours.items():
        timed(work, 1)  # compiles, and allocates the memory that is kept
        cpu_ms, peak_mib, _ = timed(work, repeat)
        row = Row(stage=stage, what="ours", cpu_ms=cpu_ms, ratio=1.0, peak_mib=peak_mib)
        if stage == CARVE:
            row = replace(row, n_voxels=int(inside.sum()))
        if stage in (MESH, INTEGRATE):
            row = replace(
                row, mesh_mm3=solid_of(mesh.vertices_mm, mesh.faces).volume_mm3, n_faces=len(mesh.faces)
            )
        rows.append(row)
    for name in track(names, console=Console(stderr=True), transient=True):
        peer = PEERS[name]
        before_ms = timed(ours[peer.stage], repeat)[0], timed(ours[CARVE_FINE], repeat)[0]
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, mp_context=context) as process:
            cost = process.submit(cost_of, name, task, repeat).result()
        row = Row(stage=peer.stage, what=peer.what, is_same_hull=peer.is_same_hull)
        if cost is not None:
            after_ms = timed(ours[peer.stage], repeat)[0], timed(ours[CARVE_FINE], repeat)[0]
            ours_ms, fine_ms = (mean(pair) for pair in zip(before_ms, after_ms, strict=True))
            row = replace(
                row,
                cpu_ms=cost.cpu_ms,
                ratio=cost.cpu_ms / ours_ms,
                ratio_fine=cost.cpu_ms / fine_ms if peer.stage == CARVE else None,
                peak_mib=cost.peak_mib,
                mesh_mm3=cost.mesh_mm3,
                n_faces=cost.n_faces,
            )
            if cost.hull is not None:
                hull = np.unpackbits(cost.hull).astype(bool).reshape(inside.shape)
                differing = int((hull != inside).sum()) / n_surface
                row = replace(row, n_voxels=int(hull.sum()), differing=differing)
        rows.append(row)
    return sorted(rows, key=lambda row: list(ours).index(row.stage))


def table_of(rows: list[Row], title: str) -> Table:
    table = Table(
        title=title,
        caption="x ours: time relative to our code in the same minutes; x sub-voxel: relative to our sub-voxel carving;"
        " differing: share of the surface voxels that differ from ours",
    )
    table.add_column("stage")
    table.add_column("by")
    for heading in ("CPU ms", "x ours", "x sub-voxel", "peak MiB", "voxels", "differing", "mm3", "faces"):
        table.add_column(heading, justify="right")
    stage = ""
    for row in rows:
        if row.stage != stage:
            table.add_section()
        table.add_row(
            row.stage if row.stage != stage else "",
            row.what,
            "not installed" if row.cpu_ms is None else f"{row.cpu_ms:.1f}",
            cell(row.ratio, ".1f"),
            cell(row.ratio_fine, ".1f"),
            cell(row.peak_mib, ".0f"),
            cell(row.n_voxels, "d"),
            cell(row.differing, ".1e"),
            cell(row.mesh_mm3, ".1f"),
            cell(row.n_faces, "d"),
        )
        stage = row.stage
    return table


def cell(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


if __name__ == "__main__":
    sys.exit(main())
