import filecmp
import json
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
from support.recordings import CAMERAS, SIZE_PX, make_bundle, small_rig, tagged_image, write_recording
from typer.testing import CliRunner

from drivers.errors import RecordingError
from drivers.files.png_file import write_png
from drivers.files.recording import open_recording, playback_order, read_bundle
from drivers.files.rig_file import write_rig
from pipeline.frames import BundleKind
from service.base.errors import UsageError
from service.commands.images import export_command, import_command


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Write images of ten stones and an empty rig; stone 3 lacks a view."""
    folder = tmp_path / "images"
    for number, name in enumerate(["empty", *(f"stone {i}" for i in range(1, 11))]):
        (folder / name).mkdir(parents=True)
        for camera in CAMERAS:
            if (name, camera) != ("stone 3", CAMERAS[3]):
                write_png(folder / name / f"{camera}.png", tagged_image(number, camera))
    write_rig(tmp_path / "rig.json", small_rig())
    return folder


def files_below(folder: Path) -> set[Path]:
    return {path.relative_to(folder) for path in folder.rglob("*") if path.is_file()}


def test_import_and_export_are_inverse(source: Path, tmp_path: Path) -> None:
    out, back = tmp_path / "rec", tmp_path / "back"
    import_command(source, out, tmp_path / "rig.json", ["empty"])
    recording = open_recording(out)
    assert not recording.is_simulated
    assert recording.rig is not None
    headers = playback_order(recording)
    assert [header.name for header in headers] == ["empty", *(f"stone {i}" for i in range(1, 11))]
    assert [header.kind for header in headers] == [BundleKind.BACKGROUND] + [BundleKind.PARTICLE] * 10
    third = read_bundle(headers[3].path, recording.camera_ids)
    assert dict(third.missing) == {CAMERAS[3]: "no_image"}
    assert np.array_equal(third.frames[CAMERAS[1]].image, tagged_image(3, CAMERAS[1]))
    spacings_ns = np.diff([header.trigger.received_ns for header in headers])
    assert set(spacings_ns) == {250_000_000}

    export_command(out, back)
    assert files_below(back) == files_below(source) | {Path("rig.json"), Path("backgrounds.txt")}
    assert (back / "backgrounds.txt").read_text() == "empty\n"
    assert filecmp.cmp(back / "rig.json", tmp_path / "rig.json", shallow=False)
    for name in files_below(source):
        found, expected = (imagecodecs.png_decode((root / name).read_bytes()) for root in (back, source))
        assert np.array_equal(found, expected), name


def test_export_leaves_damage_out_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_recording(tmp_path / "rec", [make_bundle(i) for i in range(3)])
    (path / "bundles" / "00000001.tiff").write_bytes(b"")
    torn = path / "bundles" / "00000002.tiff"
    torn.write_bytes(torn.read_bytes()[:-2000])
    export_command(path, tmp_path / "out")
    assert sorted(child.name for child in (tmp_path / "out").iterdir() if child.is_dir()) == [
        "00000000",
        "00000002",
    ]
    assert sorted(child.name for child in (tmp_path / "out/00000002").iterdir()) == [
        "c01.png",
        "c02.png",
        "c03.png",
    ]
    said = capsys.readouterr().err
    assert "00000001.tiff: is not a readable TIFF" in said
    assert "00000002.tiff: camera c04 is damaged" in said


WIDTH_PX, HEIGHT_PX = SIZE_PX


@pytest.mark.parametrize(
    ("name", "image", "message"),
    [
        ("c02.png", np.zeros((HEIGHT_PX, WIDTH_PX), np.uint16), r"c02\.png: is a 16-bit image"),
        ("c02.png", np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.uint8), r"c02\.png: is a colour image"),
        ("c02.png", np.zeros((WIDTH_PX, HEIGHT_PX), np.uint8), r"c02\.png: has 48x64 pixels; .* 64x48"),
        ("c99.png", np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8), r"c99\.png: 'c99' is no camera of the rig"),
        ("c02.png", None, r"c02\.png: is not a sound PNG"),
    ],
)
def test_wrong_images_are_named_and_nothing_is_written(
    source: Path, tmp_path: Path, name: str, image: np.ndarray | None, message: str
) -> None:
    content = (
        (source / "stone 4" / "c02.png").read_bytes()[:-100]
        if image is None
        else imagecodecs.png_encode(image)
    )
    (source / "stone 4" / name).write_bytes(content)
    before = set(tmp_path.iterdir())
    with pytest.raises(RecordingError, match=message):
        import_command(source, tmp_path / "rec", tmp_path / "rig.json", ["empty"])
    assert set(tmp_path.iterdir()) == before


def test_wrong_folders_are_named(source: Path, tmp_path: Path) -> None:
    rig, out = tmp_path / "rig.json", tmp_path / "rec"
    with pytest.raises(UsageError, match=r"--background nothing: .* has no such folder"):
        import_command(source, out, rig, ["nothing"])
    (source / "stone 11").mkdir()
    with pytest.raises(RecordingError, match=r"stone 11: has no image <camera id>\.png"):
        import_command(source, out, rig, ["empty"])
    with pytest.raises(RecordingError, match="has no folder of images"):
        import_command(source / "stone 1", out, rig)
    with pytest.raises(RecordingError, match="is not a folder"):
        import_command(rig, out, rig)
    with pytest.raises(RecordingError, match=r"images: exists already"):
        import_command(source, source, rig, ["empty"])
    with pytest.raises(RecordingError, match="exists already"):
        export_command(write_recording(out, [make_bundle(0)]), source)


def test_the_command_lines(source: Path, tmp_path: Path) -> None:
    import typer

    app = typer.Typer()
    app.command("import")(import_command)
    app.command("export")(export_command)
    out = tmp_path / "rec"
    arguments = ["import", str(source), str(out), "--rig", str(tmp_path / "rig.json"), "--simulated"]
    result = CliRunner().invoke(app, [*arguments, "--background", "empty", "--background", "stone 1"])
    assert result.exit_code == 0, result.output
    assert json.loads((out / "recording.json").read_text())["is_simulated"] is True
    kinds = [header.kind for header in open_recording(out).headers]
    assert kinds.count(BundleKind.BACKGROUND) == 2
    assert kinds[:2] == [BundleKind.BACKGROUND] * 2
    assert CliRunner().invoke(app, ["export", str(out), str(tmp_path / "back")]).exit_code == 0
    assert CliRunner().invoke(app, ["import", str(source)]).exit_code == 2
