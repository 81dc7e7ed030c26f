"""`stonefall measure`: the promised files, the same for any number of workers."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from support.measuring_here import measuring_here
from support.networks import darkness_network
from support.rendered import recording_of
from support.small_recording import thumbnail_rig, write_small_recording
from typer.testing import CliRunner

from drivers.errors import RecordingError
from drivers.files.recording import open_recording, read_bundle, write_bundle
from pipeline.fall import pulse_width_ns
from pipeline.frames import BundleKind, CameraId, FrameBundle
from pipeline.rig.cameras import rig_to_document
from pipeline.rig.design import nominal_rig
from pipeline.synthesis.bodies import Body, sphere
from pipeline.synthesis.bundles import render_bundle, render_empty, stream, without_views
from pipeline.synthesis.renderer import PlacedBody, simulate_rig
from service.base.errors import UsageError
from service.commands import measure
from service.commands.cli import build_app
from service.commands.measure import _print_summary

APP = build_app()


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("measure") / "recording"
    write_small_recording(path, n_stones=3)
    return path


def run(*arguments: object) -> str:
    result = CliRunner().invoke(APP, ["measure", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture(autouse=True)
def in_this_process(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Measure without workers where the test is not about them."""
    if request.node.originalname != "test_files_are_as_promised_and_independent_of_the_workers":
        monkeypatch.setattr(measure, "measuring_pool", measuring_here)


def records(out: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()]


def untimed(out: Path) -> list[dict[str, Any]]:
    return [{key: value for key, value in record.items() if key != "timings_ms"} for record in records(out)]


def test_files_are_as_promised_and_independent_of_the_workers(recording: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    run(recording, "--out", one, "--workers", 1, "--save-silhouettes")
    summary = json.loads(run(recording, "--out", two, "--workers", 2, "--json"))
    assert summary == {"bundles": 3, "measured": 3, "rejected": 0, "lost": 0}
    assert untimed(one) == untimed(two)
    names = [record["bundle"] for record in records(one)]
    assert names == sorted(names)
    for record in records(one):
        assert record["outcome"] == "measured"
        assert record["equivalent_diameter_mm"] == pytest.approx(15.0, abs=0.05)
        assert record["gate_extent_mm"] == pytest.approx(15.0, abs=0.2)
        assert record["gate_extent_is_plausible"] is True
        assert record["is_simulated"] is True
        mesh = trimesh.load(one / record["mesh"], process=False)
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(record["volume_estimate_mm3"], rel=1e-4)
        assert record["hull"]["volume_mm3"] == record["volume_raw_mm3"] > record["volume_estimate_mm3"]
        assert (record["body"], record["volume_model"]) == ("estimate", "synthetic-3")
        assert (one / record["mesh"]).read_bytes() == (two / record["mesh"]).read_bytes()
        silhouettes = one / "silhouettes" / record["bundle"]
        assert {path.stem for path in silhouettes.iterdir()} == set(record["views"])
        labels = cv2.imread(str(silhouettes / "c01.png"), cv2.IMREAD_UNCHANGED)
        assert labels.shape == (256, 320)
        assert set(np.unique(labels)) <= {0, 128, 255}
        assert {"segment", "carve", "mesh", "estimate", "measure", "total"} <= set(record["timings_ms"])
    assert not (two / "silhouettes").exists()
    assert sorted(path.name for path in two.iterdir()) == [
        "gradation.json", "gradation.svg", "meshes", "results.jsonl",
    ]  # fmt: skip
    curve = json.loads((one / "gradation.json").read_text())
    assert curve["n_stones"] == 3
    assert len(curve["passing_percent"]) == len(curve["sieves_mm"])
    assert curve["passing_percent"][-1] == 100
    assert set(curve["quantiles_mm"]) == {"D10", "D30", "D50", "D60", "D90"}
    points = {point["sieve_mm"]: point["by_mass"] for point in curve["curve"]}
    assert (points[2.0]["state"], points[2.0]["value"]) == ("not_measured", None)
    assert (points[20.0]["state"], points[20.0]["value"]) == ("insufficient", 100)
    assert curve["indices"]["shape"]["value"] == 0, "spheres"
    assert curve["unmeasured"]["n_stones"] == 0


@pytest.mark.full
def test_imported_masks_are_silhouettes_and_never_claim_more_than_they_show(
    recording: Path, tmp_path: Path
) -> None:
    """The silhouettes of photographs, given as masks: the same body, to what whole pixels tell of it."""
    run(recording, "--out", tmp_path / "out", "--workers", 1, "--save-silhouettes")
    folders = tmp_path / "out" / "silhouettes"
    for path in folders.rglob("*.png"):
        labels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(path), np.where(labels == 255, np.uint8(255), np.uint8(0)))
    masks = tmp_path / "masks"
    arguments = ["import", str(folders), str(masks), "--rig", str(recording / "rig.json"), "--masks"]
    assert CliRunner().invoke(APP, arguments, catch_exceptions=False).exit_code == 0
    run(masks, "--out", tmp_path / "of-masks", "--workers", 1)
    for expected, found in zip(records(tmp_path / "out"), records(tmp_path / "of-masks"), strict=True):
        assert set(found["segmenters"].values()) == {"mask"}
        assert (found["body"], found["quality"] == "good") == ("estimate", False)
        sd = found["volume_sd_percent"] / 100
        assert found["volume_mm3"] == pytest.approx(expected["volume_mm3"], rel=2 * sd)
        assert found["volume_sd_percent"] > 2 * expected["volume_sd_percent"]
    for unfit in (["--segmenter", "auto"], ["--body", "photo"], ["--texture"], ["--method", "paper"]):
        result = CliRunner().invoke(APP, ["measure", str(masks), "--out", str(tmp_path / "no"), *unfit])
        assert isinstance(result.exception, UsageError)
        assert "holds masks" in str(result.exception)


def test_the_hull_itself_can_be_asked_for(recording: Path, tmp_path: Path) -> None:
    run(recording, "--out", tmp_path, "--workers", 1, "--body", "hull", "--mesher", "skimage")
    for record in records(tmp_path):
        assert record["body"] == "hull"
        mesh = trimesh.load(tmp_path / record["mesh"], process=False)
        assert mesh.volume == pytest.approx(record["volume_raw_mm3"], rel=1e-4)
        assert record["surface_area_mm2"] == record["hull"]["surface_area_mm2"]
        assert (record["volume_model"], record["volume_estimate_mm3"]) == ("sphere", None)
        assert record["equivalent_diameter_mm"] == pytest.approx(15.0, abs=0.05)


def test_the_body_can_be_refined_by_its_pixels_or_it_is_said_why_not(recording: Path, tmp_path: Path) -> None:
    run(recording, "--out", tmp_path, "--workers", 1)
    for record in records(tmp_path):
        assert record["outcome"] == "measured"
        assert "refine" in record["timings_ms"]
        assert (record["body"] == "photo") == (record["refinement_fallback"] is None)
        assert 0 <= record["supported_share"] <= 1
        assert record["equivalent_diameter_mm"] == pytest.approx(15.0, abs=0.1)
        assert trimesh.load(tmp_path / record["mesh"], process=False).is_watertight


@pytest.mark.parametrize(
    ("arguments", "is_textured"),
    [
        ((), True),
        (("--no-texture",), False),
        (("--body", "estimate", "--texture"), True),
        (("--body", "estimate"), False),
    ],
)
def test_meshes_are_textured_where_that_is_asked_for(
    recording: Path, tmp_path: Path, arguments: tuple[str, ...], is_textured: bool
) -> None:
    run(recording, "--out", tmp_path, "--workers", 1, *arguments)
    for record in records(tmp_path):
        assert ("texture" in record["timings_ms"]) == is_textured
        mesh = trimesh.load(tmp_path / record["mesh"], process=False)
        assert (mesh.visual.kind == "vertex") == is_textured
        if is_textured:
            assert 30 < mesh.visual.vertex_colors[:, 0].mean() < 90, "spheres of grey level 60"


def test_paper_s_field_and_a_configuration_s_parameters(recording: Path, tmp_path: Path) -> None:
    config = tmp_path / "stonefall.toml"
    config.write_text(
        f'[rig]\nrecording = "{recording}"\n[spool]\ndir = "s"\n[store]\ndir = "t"\n'
        "[carving]\nn = 64\n[measuring]\ndensity_g_cm3 = 2.7\n"
    )
    run(recording, "--out", tmp_path / "out", "--config", config, "--field", "view_count", "--workers", 1)
    for record in records(tmp_path / "out"):
        assert record["mass_g"] == pytest.approx(2.7e-3 * record["volume_mm3"])
        # at a quarter of the samples the erosion of the paper's field is four times as deep
        assert record["equivalent_diameter_mm"] < 14.9


@pytest.mark.full
def test_the_network_needs_no_empty_rig(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=1, n_backgrounds=0)
    run(tmp_path / "recording", "--out", tmp_path / "out", "--workers", 1)
    (record,) = records(tmp_path / "out")
    assert record["outcome"] == "measured"
    assert record["equivalent_diameter_mm"] == pytest.approx(15.0, abs=0.1)
    assert record["quality_causes"] == ["hidden"]  # with a quarter of the pixels no texture shows dents
    assert set(record["segmenters"].values()) == {"network"}
    assert record["segmentation_flags"] == dict.fromkeys(record["views"], "no background yet")


def test_a_model_that_was_asked_for_must_be_there(recording: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.onnx"
    damaged.write_bytes(b"no model")
    for arguments in (["--segmenter", "onnx"], []):
        with pytest.raises(UsageError, match=r"damaged\.onnx: expected an ONNX model"):
            run(recording, "--out", tmp_path / "out", "--model", damaged, *arguments)
        with pytest.raises(UsageError, match="there is no such model"):
            run(recording, "--out", tmp_path / "out", "--model", tmp_path / "gone.onnx", *arguments)
    assert not (tmp_path / "out").exists()


@pytest.mark.full
def test_bundles_that_are_not_as_they_should_be(tmp_path: Path) -> None:
    """Record stones with 14 views, a wrong view, no body, two bodies, a cut view, a ball, and another stone's pulse."""
    rig = thumbnail_rig()
    simulated = simulate_rig(rig, stream(3, 0))

    def at(body: Body, *offset_mm: float) -> PlacedBody:
        return PlacedBody(body=body, R=np.eye(3), offset_mm=np.array(offset_mm))

    def exposed(number: int, label: str, *bodies: PlacedBody) -> FrameBundle:
        rng = stream(3, 1, number)
        return render_bundle(bodies, simulated, rng, sequence=number, label=label)

    whole = exposed(2, "wrong", at(sphere(), 0, 1, 0))
    other = exposed(7, "swapped", at(sphere(9.0), 3, -2, 2))
    bundles = [
        render_empty(simulated, stream(3, 2), sequence=0),
        without_views(
            exposed(1, "fourteen", at(sphere(), 0, 0, 1)), [CameraId("c03"), CameraId("c12")], "no_frame"
        ),
        replace(whole, frames={**whole.frames, CameraId("c08"): other.frames[CameraId("c08")]}),
        exposed(3, "empty"),
        exposed(4, "double", at(sphere(8.0), 8, 0, 2), at(sphere(7.0), -8, 1, -2)),
        exposed(5, "cut", at(sphere(), 0, 0, -25)),
        exposed(6, "ball", at(replace(sphere(10.0), kind=BundleKind.BALL), 1, 0, 0)),
        replace(other, trigger=replace(other.trigger, pulse_width_ns=pulse_width_ns(25))),
    ]
    recording = tmp_path / "recording"
    with recording_of(recording, rig, {"test": "special"}) as writer:
        for bundle in bundles:
            writer.add(bundle)
    run(recording, "--out", tmp_path / "out", "--workers", 2)
    found = {record["bundle"].partition("-")[2]: record for record in records(tmp_path / "out")}
    assert {name: (r["outcome"], r["reason"]) for name, r in found.items()} == {
        "fourteen": ("measured", None),
        "wrong": ("measured", None),
        "empty": ("rejected", "empty"),
        "double": ("rejected", "multiple"),
        "cut": ("rejected", "clipped"),
        "ball": ("measured", None),
        "swapped": ("measured", None),
    }
    assert (found["fourteen"]["quality"], found["fourteen"]["quality_causes"]) == ("reduced", ["hidden"])
    assert found["fourteen"]["dropped_views"] == {"c03": "no_frame", "c12": "no_frame"}
    assert found["wrong"]["quality_causes"] == ["hidden"]
    assert list(found["wrong"]["dropped_views"]) == ["c08"]
    for name in ("fourteen", "wrong"):
        assert found[name]["equivalent_diameter_mm"] == pytest.approx(15.0, abs=0.05)
    at_the_gate = {
        name: (
            r["gate_extent_mm"] and pytest.approx(r["gate_extent_mm"], rel=0.01),
            r["gate_extent_is_plausible"],
        )
        for name, r in found.items()
    }
    assert at_the_gate == {
        "fourteen": (15.0, True),
        "wrong": (15.0, True),
        "empty": (None, None),
        "double": (11.5, None),
        "cut": (15.0, None),
        "ball": (10.0, True),
        "swapped": (25.0, False),
    }
    curve = json.loads((tmp_path / "out" / "gradation.json").read_text())
    assert curve["n_stones"] == 3, "a calibration ball is no stone"


@pytest.mark.full
def test_a_damaged_bundle_costs_only_itself(tmp_path: Path) -> None:
    recording = tmp_path / "recording"
    write_small_recording(recording, n_stones=2)
    damaged = sorted((recording / "bundles").iterdir())[2]
    damaged.write_bytes(damaged.read_bytes()[:100])
    run(recording, "--out", tmp_path / "out", "--workers", 1)
    outcomes = {record["bundle"]: record for record in records(tmp_path / "out")}
    assert len(outcomes) == 2
    assert outcomes[damaged.stem]["outcome"] == "lost"
    assert outcomes[damaged.stem]["reason"] == "unreadable"
    assert [record["outcome"] for record in outcomes.values()].count("measured") == 1


def test_a_view_with_a_damaged_pixel_is_not_used(tmp_path: Path) -> None:
    recording = tmp_path / "recording"
    write_small_recording(recording, n_stones=1)
    *_, stone = sorted((recording / "bundles").iterdir())
    bundle = read_bundle(stone, open_recording(recording).camera_ids)
    write_bundle(stone, bundle, sorted(bundle.frames), compression="none")
    content = stone.read_bytes()
    where = content.index(bundle.frames[CameraId("c05")].image.tobytes())
    stone.write_bytes(content[:where] + bytes([content[where] ^ 1]) + content[where + 1 :])
    run(recording, "--out", tmp_path / "out", "--workers", 1)
    (record,) = records(tmp_path / "out")
    assert (record["outcome"], record["dropped_views"]) == ("measured", {"c05": "damaged"})


@pytest.mark.full
def test_a_folder_has_the_results_of_one_run_alone(tmp_path: Path) -> None:
    out = tmp_path / "out"
    for number, n_stones in enumerate((2, 1)):
        recording = tmp_path / str(number)
        write_small_recording(recording, n_stones=n_stones)
        bundles = sorted(path.stem for path in (recording / "bundles").iterdir())[-n_stones:]
        options = ("--save-silhouettes",) if number == 0 else ()
        run(recording, "--out", out, "--workers", 1, *options)
        assert [record["bundle"] for record in records(out)] == bundles
        assert sorted(path.stem for path in (out / "meshes").iterdir()) == bundles
    assert {path.name for path in out.iterdir()} == {
        "results.jsonl",
        "meshes",
        "gradation.json",
        "gradation.svg",
    }


def test_folders_of_others_are_left_alone(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    with pytest.raises(UsageError, match=r"has meshes/ but no results\.jsonl"):
        run(recording, "--out", tmp_path)


@pytest.mark.full
def test_what_does_not_get_to_its_end_changes_nothing(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(recording, "--out", tmp_path, "--workers", 1)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    monkeypatch.setattr(measure, "evaluate", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run(recording, "--out", tmp_path, "--workers", 1)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_recording_without_rig_needs_one(recording: Path, tmp_path: Path) -> None:
    (tmp_path / "copy/bundles").mkdir(parents=True)
    bundles = sorted(path.relative_to(recording) for path in (recording / "bundles").iterdir())
    for path in ("recording.json", *bundles[:3]):  # one stone
        (tmp_path / "copy" / path).symlink_to(recording / path)
    with pytest.raises(UsageError, match="--rig"):
        run(tmp_path / "copy", "--out", tmp_path / "out")
    run(tmp_path / "copy", "--out", tmp_path / "out", "--rig", recording / "rig.json", "--workers", 1)


def test_wrong_input_is_refused_before_anything_is_written(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(RecordingError, match="nothing"):
        run(tmp_path / "nothing", "--out", out)
    few = rig_to_document(nominal_rig().subset(nominal_rig().camera_ids[:3]))
    (tmp_path / "few.json").write_text(json.dumps(few))
    with pytest.raises(RecordingError, match=r"few\.json.*c04"):
        run(recording, "--out", out, "--rig", tmp_path / "few.json")
    (tmp_path / "large.json").write_text(json.dumps(rig_to_document(nominal_rig())))
    with pytest.raises(RecordingError, match=r"large\.json: camera c01: images of 1280x1024"):
        run(recording, "--out", out, "--rig", tmp_path / "large.json")
    assert not out.exists()


def test_report_names_dropped_views(capsys: pytest.CaptureFixture[str]) -> None:
    record = {
        "bundle": "b", "outcome": "measured", "quality": "reduced", "volume_mm3": 1.0, "sieve_size_mm": 1.0,
        "views": ["c01"], "detail": None, "dropped_views": {"c02": "empty"},
    }  # fmt: skip
    _print_summary([record], as_json=False)
    printed = capsys.readouterr().out
    assert "c02 empty" in " ".join(printed.split())
    assert "1 bundles = 1 measured + 0 rejected + 0 lost" in printed


@pytest.mark.full
def test_the_papers_method_as_a_whole(recording: Path, tmp_path: Path) -> None:
    """With a network that finds what is dark: masks, counted voxels, scikit-image, and nothing corrected."""
    model = tmp_path / "darkness.onnx"
    model.write_bytes(darkness_network())
    whole = ("--method", "paper", "--model", model, "--workers", 1)
    run(recording, "--out", tmp_path / "whole", *whole)
    for record in records(tmp_path / "whole"):
        assert (record["body"], record["volume_model"], record["dropped_views"]) == ("hull", "none", {})
        assert set(record["segmenters"].values()) == {"u2net"}
        assert record["quality"] != "good"
        assert record["volume_mm3"] == record["volume_raw_mm3"]
        assert record["equivalent_diameter_mm"] == pytest.approx(15.0, abs=0.3)
    run(recording, "--out", tmp_path / "inner", *whole, "--isolevel", 15.9)
    for inner, outer in zip(records(tmp_path / "inner"), records(tmp_path / "whole"), strict=True):
        assert inner["volume_mm3"] < outer["volume_mm3"]
    wrong = [str(each) for each in ("measure", recording, "--out", tmp_path, *whole, "--isolevel", 16)]
    assert "isolevel must be from 15 to less than 16" in CliRunner().invoke(APP, wrong).output
