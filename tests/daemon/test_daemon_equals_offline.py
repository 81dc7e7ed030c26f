"""The daemon and `stonefall measure` give the same results, bit for bit, whatever the number of workers."""

import json
from pathlib import Path

import numpy as np
import pytest
from support.daemon_process import DaemonProcess
from support.extents import first_quick
from support.small_recording import write_small_recording
from support.stores import folder_of
from trimesh.visual import ColorVisuals
from typer.testing import CliRunner

from drivers.files.compact_mesh import STEP_MM, read_compact_mesh
from drivers.files.mesh_parsing import parse_mesh
from service.commands.cli import build_app
from service.results.fields import MEASURED_FIELDS

COMPARED = (
    "bundle", "sequence", "kind", "captured_at", "outcome", "reason", "detail", "quality", "views",
    "dropped_views", "segmenters", "segmentation_flags", *MEASURED_FIELDS, "gate_extent_mm", "gate_extent_is_plausible",
    "view_residuals_px", "calibration_id", "algorithm_version", "is_simulated",
)  # fmt: skip


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five spheres; one bundle cannot be read at all, one only in part."""
    path = tmp_path_factory.mktemp("spheres") / "recording"
    write_small_recording(path, n_stones=5)
    document = json.loads((path / "recording.json").read_text())
    document["gate_settings"] = {"speed_at_gate_mm_s": 100.0}
    (path / "recording.json").write_text(json.dumps(document))
    header, torn, page = sorted((path / "bundles").iterdir())[-3:]
    header.write_bytes(header.read_bytes()[:50])  # cannot be read at all
    torn.write_bytes(torn.read_bytes()[:-2000])  # the header is sound, the last pages are not
    assert page.exists()
    return path


@pytest.fixture(scope="module")
def offline(tmp_path_factory: pytest.TempPathFactory, recording: Path) -> Path:
    """What `stonefall measure` makes of it with two workers."""
    folder = tmp_path_factory.mktemp("offline")
    config = DaemonProcess(folder, recording, body="photo").config_path
    arguments = ["measure", str(recording), "--out", str(folder / "out"), "--workers", "2"]
    result = CliRunner().invoke(build_app(), [*arguments, "--config", str(config)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return folder / "out"


@pytest.mark.parametrize(("slots", "exact_meshes"), first_quick([(3, "false"), (1, "true")]))
def test_daemon_equals_offline(
    tmp_path: Path, recording: Path, offline: Path, slots: int, exact_meshes: str
) -> None:
    store = f"exact_meshes = {exact_meshes}"
    with DaemonProcess(tmp_path, recording, slots=slots, store=store, body="photo") as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda counts: counts["triggers"] == 5 and not counts["in_progress"])
        live = daemon.get("/results?after=0")["items"]
    theirs = [json.loads(line) for line in (offline / "results.jsonl").read_text().splitlines()]
    assert len(live) == len(theirs) == 5
    assert [record["outcome"] for record in theirs] == [*["measured"] * 4, "lost"]
    assert theirs[-1]["reason"] == "unreadable"
    assert theirs[2]["dropped_views"]
    for record in theirs[:4]:  # the pulses are those of spheres of 15 mm that were let go at the beam
        assert record["gate_extent_mm"] == pytest.approx(15.0 + 100 * 0.0553, abs=0.2)
        assert record["gate_extent_is_plausible"] is False
    for ours, other in zip(live, theirs, strict=True):
        assert {key: ours[key] for key in COMPARED} == {key: other[key] for key in COMPARED}
        if ours["mesh"] is not None:
            folder, exact = folder_of(tmp_path / "state", ours["id"]), offline / other["mesh"]
            if exact_meshes == "true":
                assert (folder / "mesh.ply").read_bytes() == exact.read_bytes()
                continue
            vertices_mm, faces, greys = read_compact_mesh(folder / "mesh.sfmesh")
            mesh = parse_mesh(exact)
            np.testing.assert_array_equal(faces, mesh.faces)
            assert isinstance(mesh.visual, ColorVisuals)
            np.testing.assert_array_equal(greys, mesh.visual.vertex_colors[:, 0])
            np.testing.assert_allclose(vertices_mm, mesh.vertices, rtol=0, atol=0.51 * STEP_MM)
            assert 4 * (folder / "mesh.sfmesh").stat().st_size < exact.stat().st_size
