"""Prints what one bundle costs, stage by stage: CPU time of one core, from the file to the durable result.

Run: .venv/bin/python tests/benchmarks/bundle.py [--repeat 5]
"""

import argparse
import asyncio
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from support import rendered

from drivers.recording import write_bundle
from pipeline.particle import PipelineParameters
from pipeline.synthesis.bundles import render_bundle, stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import stone
from service import worker_job
from service.store import open_store

SIZES_MM = (5.0, 15.0, 25.0, 40.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=5, help="stones a size")
    repeat = parser.parse_args().repeat
    with tempfile.TemporaryDirectory() as folder:
        table = measure_sizes(Path(folder), repeat)
    console = Console(width=120)
    console.print(f"CPU ms of one core, median of {repeat} stones a size; load {os.getloadavg()[0]:.1f}")
    console.print(table)


def measure_sizes(folder: Path, repeat: int) -> Table:
    rig = rendered.rig()
    worker_job.write_background(folder / "background.npz", rendered.background())
    context = worker_job.WorkerContext(rig=rig, parameters=PipelineParameters(), is_simulated=True)
    worker_job.initialize(context)
    # stages are timed by the process' CPU clock instead of the wall's
    time.perf_counter = time.process_time  # type: ignore[assignment]
    table = Table("stone mm", *STAGES, "total", "min", "max", "rendering it")
    for row, size_mm in enumerate((SIZES_MM[1], *SIZES_MM)):
        runs = [
            one_bundle(folder, f"{row}-{number}", size_mm, stream(7, row, number)) for number in range(repeat)
        ]
        if row == 0:
            continue  # warms up
        totals = [sum(run[stage] for stage in STAGES) for run in runs]
        cells = [f"{statistics.median(run[stage] for run in runs):.0f}" for stage in STAGES]
        summary = [f"{statistics.median(totals):.0f}", f"{min(totals):.0f}", f"{max(totals):.0f}"]
        rendering = f"{statistics.median(run['render'] for run in runs):.0f}"
        table.add_row(f"{size_mm:.0f}", *cells, *summary, rendering)
    return table


STAGES = ("load", "segment", "check", "carve", "mesh", "measure", "write", "store")


def one_bundle(folder: Path, name: str, size_mm: float, rng: Any) -> dict[str, float]:
    rig = rendered.rig()
    placed = tumble(stone("angular", size_mm, rng), rig, rng)
    simulated = rendered.simulated()
    start = time.process_time()
    bundle = render_bundle([placed], simulated, rng, sequence=1, label=name)
    render_ms = 1000 * (time.process_time() - start)
    path = folder / f"{name}.tiff"
    write_bundle(path, bundle, rig.camera_ids, compression="none")
    job = worker_job.MeasureJob(
        bundle_path=path,
        camera_ids=rig.camera_ids,
        background_path=folder / "background.npz",
        out_dir=folder / name,
    )
    record = worker_job.measure(job)
    assert record["outcome"] == "measured", record
    start = time.process_time()
    asyncio.run(store_one(folder / f"state-{name}", bundle.trigger, name, record, job.out_dir))
    store_ms = 1000 * (time.process_time() - start)
    return record["timings_ms"] | {"store": store_ms, "render": render_ms}


async def store_one(folder: Path, trigger: Any, name: str, record: dict[str, Any], files: Path) -> None:
    with open_store(folder) as store:
        session = await store.begin_session({})
        await store.record_trigger(session, trigger, name)
        await store.finish(session, name, record, {"mesh.ply": files / "mesh.ply"})


if __name__ == "__main__":
    main()
