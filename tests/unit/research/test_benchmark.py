"""`stonefall benchmark`: its arguments, and one small run of each kind."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from research import performance as performance_bench
from research import scaling as scaling_bench
from research.accuracy import BenchPlan, BenchResult
from research.tables import size_table
from support.networks import darkness_network
from typer.testing import CliRunner, Result

from pipeline.evaluation.surface_distances import SurfaceDistances
from pipeline.evaluation.trials import METHODS, ShapeErrors, Trial
from service.commands.cli import build_app

RUNNER = CliRunner()


def run(*arguments: str) -> Result:
    return RUNNER.invoke(build_app(["benchmark"]), ["benchmark", "--accuracy", *arguments])


@pytest.fixture
def wedge(tmp_path: Path) -> Path:
    """Write the mesh of a wedge, which is no standard body."""
    path = tmp_path / "wedge.stl"
    trimesh.convex.convex_hull([[0, 0, 0], [14, 0, 0], [0, 12, 0], [0, 0, 9], [14, 0, 9]]).export(path)
    return path


@pytest.mark.full
def test_a_mesh_file_through_all_methods(wedge: Path, tmp_path: Path) -> None:
    pictures = tmp_path / "pictures"
    result = run(
        "--bodies", str(wedge), "--poses", "1", "--rigs", "true", "--pictures", str(pictures), "--json"
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert document["seed"] == 1
    by_method = {trial["method"]: trial for trial in document["trials"]}
    assert set(by_method) == {"exact hull", *METHODS}
    for trial in by_method.values():
        assert (trial["body"], trial["rig"], trial["failure"]) == ("wedge", "true", None)
    floor, hull = by_method["exact hull"]["distances"], by_method["hull"]["distances"]
    assert hull["mean_mm"] == pytest.approx(floor["mean_mm"], abs=0.01)
    assert by_method["estimate"]["distances"]["mean_mm"] < hull["mean_mm"]
    assert by_method["hull"]["errors"]["volume_percent"] > 1

    names = {path.name for path in pictures.iterdir()}
    assert names == {
        f"wedge-true-{method}.png" for method in ("exact-hull", "papers-field", "hull", "estimate", "photo")
    }
    picture = cv2.imread(str(pictures / "wedge-true-hull.png"))
    assert picture is not None
    blue, _, red = np.moveaxis(picture.astype(int), -1, 0)
    n_outside, n_inside = (red - blue > 60).sum(), (blue - red > 60).sum()
    assert n_outside > 20 * n_inside, "a hull lies outside of its body"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--bodies", "marble"], "neither a mesh file nor one of sphere"),
        (["--bodies", " ,"], "names no body"),
        (["--rigs", "nominal"], "none of true, paper, ours"),
        (["--surface", "marble"], "none of mottled, granite"),
    ],
)
def test_wrong_usage(arguments: list[str], message: str) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert message in " ".join(result.output.replace("│", " ").split())


def test_a_body_too_large_for_the_cameras(tmp_path: Path) -> None:
    path = tmp_path / "brick.stl"
    trimesh.creation.box([240, 115, 71]).export(path)
    result = run("--bodies", str(path))
    assert result.exit_code == 1
    assert "brick.stl: reaches 138 mm from its centre" in str(result.exception)


def test_a_file_named_as_a_generated_body(wedge: Path) -> None:
    result = run("--bodies", str(wedge.rename(wedge.with_name("cube.stl"))))
    assert result.exit_code == 1
    assert "rename the file" in str(result.exception)


def test_two_files_of_one_name(wedge: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / wedge.name
    other.write_bytes(wedge.read_bytes())
    result = run("--bodies", f"{wedge},{other}")
    assert result.exit_code == 1
    assert "another mesh file is also named wedge" in str(result.exception)


def test_errors_of_sizes_are_told_as_bias_and_rms() -> None:
    distances = SurfaceDistances(mean_mm=0, max_mm=0, signed_mm=0, back_mean_mm=0, back_max_mm=0)
    trials = [
        Trial(
            body="sphere", number=number, rig="true", method="hull", failure=None, distances=distances,
            errors=ShapeErrors(
                mesh_volume_percent=0, volume_percent=0, area_percent=0, max_feret_mm=0.3,
                min_feret_mm=-0.1, thickness_mm=error_mm, sieve_size_mm=2 * error_mm,
            ),
        )
        for number, error_mm in enumerate((0.1, 0.7))
    ]  # fmt: skip
    result = BenchResult(trials=tuple(trials), reports={}, refused={})
    table = size_table(BenchPlan(poses={"sphere": 2}), result)
    cells = {str(column.header): list(column.cells) for column in table.columns}
    assert cells["sieve"] == ["+0.800, 1.000"]
    assert cells["thickness"] == ["+0.400, 0.500"]
    assert cells["max Feret"] == ["+0.300, 0.300"]
    assert cells["min Feret"] == ["-0.100, 0.100"]


@pytest.mark.full
def test_the_paper_beside_ours_on_the_same_images(tmp_path: Path) -> None:
    """With a network that finds what is dark in a U2-Net's place; the true one gives the figures of the README."""
    model, pictures = tmp_path / "darkness.onnx", tmp_path / "pictures"
    model.write_bytes(darkness_network())
    arguments = (
        "--paper",
        "--model",
        model,
        "--bodies",
        "sphere,cube",
        "--poses",
        "1",
        "--pictures",
        pictures,
        "--json",
    )
    result = RUNNER.invoke(build_app(["benchmark"]), ["benchmark", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    distances = {row["body"]: row for row in document["distances"]}
    assert set(distances) == {"sphere", "cube"}
    for row in distances.values():
        assert 0.02 < row["paper_mm"] < 0.4
        assert row["ratio"] == row["paper_mm"] / row["ours_mm"] > 5
    levels = {
        row["isolevel"]: row["mesh_volume_percent"]
        for row in document["isolevels"]
        if row["body"] == "sphere"
    }
    assert levels[15.1] > levels[15.5] > levels[15.9]
    errors_px = document["calibration"]["paper"]
    assert len(errors_px["after_px"]) == 16
    assert max(errors_px["after_px"].values()) < 1 < min(errors_px["before_px"].values())
    assert document["seconds"]["ours"]["segmentation"] < document["seconds"]["paper's method"]["segmentation"]
    assert {"figure-7.png", "figure-8.png", "figure-9.png"} < {path.name for path in pictures.iterdir()}


@pytest.mark.full
def test_times_of_each_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(performance_bench, "SIZES_MM", performance_bench.SIZES_MM[:1])
    result = RUNNER.invoke(build_app(["benchmark"]), ["benchmark", "--poses", "1", "--json"])
    assert result.exit_code == 0, result.output
    (row,) = json.loads(result.stdout)
    assert row["size_mm"] == 5.0
    assert set(row["stages_ms"]) == {"segment", "optics", "check", "carve", "mesh", "estimate", "measure"}
    assert row["cpu_ms"] == pytest.approx(sum(row["stages_ms"].values()))
    assert 0 < row["mesh_ms"] < row["hull_ms"]
    assert row["refine_ms"] + row["texture_ms"] < row["photo_ms"]
    assert row["stages_ms"]["segment"] < row["way_cpu_ms"]


def test_the_cost_of_a_surface_grows_with_the_square() -> None:
    grids = [
        scaling_bench.GridTimes(n=n, n_faces=6 * n * n, stages_ms={"mesh": 0.1 * n**2, "carve": 7.0 * n**3})
        for n in scaling_bench.GRIDS
    ]
    found = scaling_bench.Scaling(size_mm=25, grids=grids, views=[], workers=[])
    assert found.exponents() == pytest.approx({"mesh": 2, "carve": 3})


@pytest.mark.parametrize("n_views", scaling_bench.VIEWS)
def test_fewer_cameras_are_spread_over_all_layers(n_views: int) -> None:
    rig = scaling_bench.crowded_rig()
    cameras = rig.subset(scaling_bench.spread(rig, n_views)).cameras
    heights_mm = np.round([camera.center_mm[2] for camera in cameras], 6)
    directions = np.round([camera.center_mm / 300 for camera in cameras], 6)
    assert len(np.unique(directions, axis=0)) == n_views
    assert set(np.unique(heights_mm, return_counts=True)[1]) == {n_views // 4}
    assert {camera.id for camera in cameras} <= set(rig.camera_ids)
