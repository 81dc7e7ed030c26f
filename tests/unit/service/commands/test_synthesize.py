import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import typer
from support.synthetic_rigs import rig_of
from typer.testing import CliRunner

from drivers.errors import RecordingError
from drivers.files.recording import open_recording, read_bundle
from drivers.files.rig_file import read_rig, write_rig
from pipeline.errors import PipelineError
from pipeline.fall import speed_mm_s
from pipeline.frames import BundleKind, CameraId, FrameBundle
from pipeline.synthesis import shading
from service.base.errors import UsageError
from service.commands.synthesize import command

REPOSITORY = Path(__file__).parents[4]


@pytest.fixture
def rig_path(tmp_path: Path) -> Path:
    path = tmp_path / "small-rig.json"
    write_rig(path, rig_of("c02", "c07", binning=8))
    return path


def bundles_of(path: Path) -> list[FrameBundle]:
    recording = open_recording(path)
    return [read_bundle(header.path, recording.camera_ids) for header in recording.headers]


def same_pixels(a: FrameBundle, b: FrameBundle) -> bool:
    return all(np.array_equal(a.frames[camera].image, b.frames[camera].image) for camera in a.frames)


def test_without_the_extra_it_says_so_and_leaves_nothing(
    tmp_path: Path, rig_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shading, "find_spec", lambda name: None)
    with pytest.raises(PipelineError, match=r"extra \[synthesis\].*requirements-synthesis\.lock"):
        command(tmp_path / "recording", rig=rig_path)
    assert not (tmp_path / "recording").exists()


def test_only_rendering_needs_the_extra() -> None:
    code = "import sys; sys.modules['embreex'] = None; import service.commands.synthesize, service.commands.rehearse"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert "embreex" not in (REPOSITORY / "deploy/requirements.lock").read_text()


def test_a_recording_of_known_bodies_with_its_truth(tmp_path: Path, rig_path: Path) -> None:
    out = tmp_path / "recording"
    command(out, bodies="cube,stones", count=4, seed=7, rig=rig_path, backgrounds=2, size_mm=20)
    recording = open_recording(out)
    assert recording.is_simulated
    assert recording.rig is not None
    assert recording.rig.calibration_id == read_rig(rig_path).calibration_id
    names = [header.name for header in recording.headers]
    assert names == [
        "000001-background",
        "000002-background",
        "000003-cube",
        "000004-round",
        "000005-cube",
        "000006-irregular",
    ]
    assert [bundle.kind for bundle in bundles_of(out)[1:3]] == [BundleKind.BACKGROUND, BundleKind.PARTICLE]
    truths = [json.loads(line) for line in (out / "truth.jsonl").read_text().splitlines()]
    assert [truth["bundle"] for truth in truths] == names[2:]
    for truth in truths:
        mesh = trimesh.load_mesh(out / truth["mesh"])
        assert mesh.volume == pytest.approx(truth["volume_mm3"], rel=1e-4)
        np.testing.assert_allclose(mesh.center_mass, truth["center_mm"], atol=1e-3)
    assert truths[1]["max_feret_mm"] == pytest.approx(20)


def test_a_lens_changes_the_images_and_not_what_is_in_them(tmp_path: Path, rig_path: Path) -> None:
    def render(name: str, *options: str) -> list[FrameBundle]:
        out = tmp_path / name
        arguments = [
            str(out),
            "--bodies",
            "cube",
            "--count",
            "1",
            "--backgrounds",
            "1",
            "--rig",
            str(rig_path),
        ]
        app = typer.Typer()
        app.command()(command)
        done = CliRunner().invoke(app, [*arguments, *options])
        assert done.exit_code == 0, done.output
        return bundles_of(out)

    def exposure(name: str) -> dict[str, Any]:
        made_by = json.loads((tmp_path / name / "recording.json").read_text())["made_by"]
        return dict(made_by["exposure"])

    plain, sharp = render("plain"), render("sharp", "--lens", "sharp")
    f2 = render("f2", "--lens", "f2", "--blur-px", "1.5", "--read-noise", "5")
    assert all(same_pixels(a, b) for a, b in zip(plain, sharp, strict=True))
    assert not any(same_pixels(a, b) for a, b in zip(plain, f2, strict=True))
    assert (tmp_path / "f2" / "truth.jsonl").read_text() == (tmp_path / "sharp" / "truth.jsonl").read_text()
    assert exposure("sharp") == exposure("plain")
    assert exposure("sharp")["lens"] is None
    assert exposure("f2")["lens"]["f_number"] == 2
    assert (exposure("f2")["preset"], exposure("f2")["blur_px"], exposure("f2")["read_noise"]) == (
        "f2",
        1.5,
        5,
    )


@pytest.mark.full
def test_bodies_take_their_surfaces_in_turn_and_balls_keep_theirs(tmp_path: Path, rig_path: Path) -> None:
    def render(name: str, **looks: Any) -> tuple[list[FrameBundle], list[dict[str, Any]]]:
        out = tmp_path / name
        command(out, bodies="sphere,ball", count=4, seed=7, rig=rig_path, backgrounds=0, **looks)
        return bundles_of(out), truths_of(out)

    plain, _ = render("plain")
    other, truths = render("other", surfaces="mottled,granite", gloss=0.5, interreflection=True)
    look = ("surface", "gloss", "interreflection")
    assert [tuple(truth[key] for key in look) for truth in truths] == [
        ("mottled", 0.5, True),
        ("mottled", 0.0, False),
        ("granite", 0.5, True),
        ("mottled", 0.0, False),
    ]
    assert [same_pixels(a, b) for a, b in zip(plain, other, strict=True)] == [False, True, False, True]
    with pytest.raises(typer.BadParameter, match="'marble' is none of mottled, granite"):
        render("marble", surfaces="granite, marble")


def test_a_bundle_depends_on_the_seed_and_not_on_the_others(tmp_path: Path, rig_path: Path) -> None:
    def render(name: str, count: int, seed: int, backgrounds: int) -> list[FrameBundle]:
        command(
            tmp_path / name,
            bodies="stones,cube",
            count=count,
            seed=seed,
            rig=rig_path,
            backgrounds=backgrounds,
        )
        return bundles_of(tmp_path / name)[backgrounds:]

    first, longer = render("first", 2, 1, 1), render("longer", 3, 1, 2)
    assert all(same_pixels(a, b) for a, b in zip(first, longer, strict=False))
    other = render("other", 2, 2, 1)
    assert not same_pixels(first[0], other[0])


@pytest.mark.full
def test_without_a_rig_the_design_is_built_with_deviations(tmp_path: Path) -> None:
    out = tmp_path / "recording"
    command(out, bodies="ball", count=0, seed=4, backgrounds=1)
    true_rig, design = read_rig(out / "rig.json"), read_rig(out / "rig-nominal.json")
    assert design.method == "nominal"
    shifts_mm = [
        np.linalg.norm(a.center_mm - b.center_mm)
        for a, b in zip(true_rig.cameras, design.cameras, strict=True)
    ]
    np.testing.assert_allclose(shifts_mm, 2)
    assert "rig-nominal.json" in open_recording(out).document["made_by"]["rig"]


def test_a_mesh_file_can_fall(tmp_path: Path, rig_path: Path) -> None:
    mesh_path = tmp_path / "brick.stl"
    trimesh.creation.box(extents=[8, 10, 12]).export(mesh_path)
    command(tmp_path / "recording", bodies=str(mesh_path), count=1, rig=rig_path, backgrounds=0)
    truth = json.loads((tmp_path / "recording" / "truth.jsonl").read_text())
    assert truth["bundle"] == "000001-brick"
    assert truth["min_box_mm"] == pytest.approx([12, 10, 8], rel=1e-3)


def test_a_body_that_is_hardly_in_mm_is_doubted(
    tmp_path: Path, rig_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    metres = tmp_path / "metres.ply"
    trimesh.creation.box(extents=[0.008, 0.01, 0.012]).export(metres)
    command(tmp_path / "recording", bodies=str(metres), count=0, rig=rig_path, backgrounds=1)
    assert "metres.ply: warning: is 0.0175 mm long, is it in mm?; if in metres" in capsys.readouterr().err


def test_what_cannot_fall_is_refused_by_name(tmp_path: Path, rig_path: Path) -> None:
    out = tmp_path / "recording"
    with pytest.raises(typer.BadParameter, match="'pebble' is neither a mesh file nor one of ball"):
        command(out, bodies="pebble", rig=rig_path)
    meters = tmp_path / "huge.ply"
    trimesh.creation.box(extents=[800, 10, 12]).export(meters)
    with pytest.raises(UsageError, match=r"huge\.ply: reaches 400 mm .*; is 800 mm long, is it in mm\?"):
        command(out, bodies=str(meters), rig=rig_path)
    debris = tmp_path / "debris.stl"
    crumb = trimesh.creation.box(bounds=[[30, 0, 0], [30.5, 0.5, 0.5]])
    trimesh.util.concatenate([trimesh.creation.box([8, 8, 8]), crumb]).export(debris)
    with pytest.raises(UsageError, match=r"debris\.stl: has 2 bodies: the truth is one"):
        command(out, bodies=str(debris), rig=rig_path)
    opened = trimesh.creation.box()
    opened.update_faces(np.arange(11))
    opened.export(tmp_path / "open.ply")
    with pytest.raises(UsageError, match=r"open\.ply: .*not closed"):
        command(out, bodies=str(tmp_path / "open.ply"), rig=rig_path)
    assert not out.exists(), "nothing half-made is left"
    assert not list(tmp_path.glob(".recording*"))


def test_a_folder_in_use_is_left_alone(tmp_path: Path, rig_path: Path) -> None:
    out = tmp_path / "recording"
    out.mkdir()
    (out / "mine.txt").write_text("keep")
    with pytest.raises(RecordingError, match="exists already"):
        command(out, bodies="cube", count=1, rig=rig_path)
    assert [path.name for path in out.iterdir()] == ["mine.txt"]


def test_the_command_line(tmp_path: Path, rig_path: Path) -> None:
    app = typer.Typer()
    app.command()(command)
    arguments = [str(tmp_path / "recording"), "--bodies", "cube", "--count", "1", "--rig", str(rig_path)]
    done = CliRunner().invoke(app, [*arguments, "--backgrounds", "1", "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["bodies"] == 1
    assert CliRunner().invoke(app, [*arguments, "--count", "-1"]).exit_code == 2
    nothing = [*arguments[:1], "--count", "0", "--backgrounds", "0"]
    assert CliRunner().invoke(app, nothing).exit_code == 2


def truths_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (path / "truth.jsonl").read_text().splitlines()]


@pytest.mark.full
def test_balls_of_two_sizes_are_dropped_across_the_volume(tmp_path: Path, rig_path: Path) -> None:
    out = tmp_path / "recording"
    command(out, bodies="ball,ball:6", count=10, seed=1, rig=rig_path, backgrounds=0)
    truths = truths_of(out)
    assert {truth["body"] for truth in truths} == {truth["kind"] for truth in truths} == {"ball"}
    assert [truth["equivalent_diameter_mm"] for truth in truths] == pytest.approx([10, 6] * 5)
    places_mm = np.array([truth["center_mm"] for truth in truths])
    assert np.abs(places_mm).max() <= 9
    assert (np.ptp(places_mm, axis=0) > 8).all()
    with pytest.raises(typer.BadParameter, match="'ball:big': a ball's diameter is 2 to 40 mm"):
        command(tmp_path / "other", bodies="ball:big", rig=rig_path)


@pytest.mark.full
def test_a_late_exposure_shows_a_ball_lower(tmp_path: Path, rig_path: Path) -> None:
    out = tmp_path / "recording"
    command(
        out,
        bodies="ball:4",
        count=6,
        rig=rig_path,
        backgrounds=0,
        spread_mm=(0.5, 0.5, 0.0),
        fall_jitter_ms=3.0,
    )
    heights_mm = np.array([truth["center_mm"][2] for truth in truths_of(out)])
    fallen_s = np.array(
        [
            (bundle.frames[CameraId("c02")].device_ns - bundle.trigger.device_ns) / 1e9
            for bundle in bundles_of(out)
        ]
    )
    assert np.ptp(heights_mm) > 3
    slopes_mm_s = np.diff(heights_mm) / np.diff(fallen_s)
    np.testing.assert_allclose(slopes_mm_s, -speed_mm_s(300.0), rtol=0.02)
    with pytest.raises(typer.BadParameter, match="each must be 0 to 100"):
        command(tmp_path / "other", bodies="ball", rig=rig_path, spread_mm=(1.0, -1.0, 1.0))


def test_shrunk_images_show_the_same_with_fewer_pixels(tmp_path: Path, rig_path: Path) -> None:
    for name, n in (("whole", 1), ("half", 2)):
        command(tmp_path / name, bodies="cube", count=1, rig=rig_path, backgrounds=0, shrink=n)
    (whole,), (half,) = bundles_of(tmp_path / "whole"), bundles_of(tmp_path / "half")
    for camera, frame in whole.frames.items():
        height_px, width_px = frame.image.shape
        assert half.frames[camera].image.shape == (height_px // 2, width_px // 2)
        means = [
            float(each.frames[camera].image[: height_px // 2 * 2 // n, : width_px // 2 * 2 // n].mean())
            for each, n in ((whole, 1), (half, 2))
        ]
        assert means[0] == pytest.approx(means[1], abs=3)
    rigs = [open_recording(tmp_path / name).rig for name in ("whole", "half")]
    centres = [[camera.center_mm.tolist() for camera in rig.cameras] for rig in rigs if rig is not None]
    assert centres[0] == centres[1]
