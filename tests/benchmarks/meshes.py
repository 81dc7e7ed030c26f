"""Size and time of compact meshes beside PLY.

Run: .venv/bin/python tests/benchmarks/meshes.py MESH...

The meshes are those of `stonefall measure`, PLY. Milliseconds are the least of five, without the disk; deviations are
those of the vertices and of the volume.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from drivers.files.compact_mesh import read_compact_mesh, write_compact_mesh
from drivers.files.mesh_file import write_mesh
from drivers.files.mesh_parsing import parse_mesh
from pipeline.measuring.solid import solid_of


def main() -> None:
    """Print a row for each mesh."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    arguments.add_argument("meshes", type=Path, nargs="+", metavar="MESH")
    table = Table("mesh", "vertices", "PLY kB", "ms", "compact kB", "write ms", "read ms", "um", "volume ppm")
    with tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        path = Path(folder, "mesh")
        for mesh_path in arguments.parse_args().meshes:
            mesh = parse_mesh(mesh_path)
            vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
            ply_ms, ply_bytes = _ms(lambda v=vertices, f=faces: write_mesh(path, v, f)), path.stat().st_size
            write_ms = _ms(lambda v=vertices, f=faces: write_compact_mesh(path, v, f))
            read_ms = _ms(lambda: read_compact_mesh(path))
            read_vertices, read_faces, _ = read_compact_mesh(path)
            volume = solid_of(vertices, faces).volume_mm3
            deviation = solid_of(read_vertices, read_faces).volume_mm3 / volume - 1
            table.add_row(
                mesh_path.stem,
                f"{len(vertices)}",
                f"{ply_bytes / 1e3:.0f}",
                f"{ply_ms:.1f}",
                f"{path.stat().st_size / 1e3:.0f}",
                f"{write_ms:.1f}",
                f"{read_ms:.1f}",
                f"{1e3 * np.abs(read_vertices - vertices).max():.2f}",
                f"{1e6 * deviation:.3f}",
            )
    Console().print(table)


def _ms(work: Callable[[], object]) -> float:
    times_s = []
    for _ in range(5):
        start_s = time.perf_counter()
        work()
        times_s.append(time.perf_counter() - start_s)
    return 1e3 * min(times_s)


if __name__ == "__main__":
    main()
