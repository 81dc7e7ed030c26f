import filecmp
import json
import re
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import tifffile
import typer
from support.recordings import CAMERAS, SIZE_PX, make_bundle, small_rig, tagged_image, write_recording
from typer.testing import CliRunner

from drivers.errors import RecordingError
from drivers.files.image_file import write_png
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
    import_command(back, tmp_path / "again", back / "rig.json")
    again = open_recording(tmp_path / "again")
    assert [header.kind for header in playback_order(again)] == [header.kind for header in headers]


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
N_PIXELS = WIDTH_PX * HEIGHT_PX


@pytest.mark.parametrize(
    ("name", "image", "message"),
    [
        ("c02.png", np.arange(3 * N_PIXELS).reshape(HEIGHT_PX, WIDTH_PX, 3), r"c02\.png: is a colour image"),
        ("c02.png", np.eye(HEIGHT_PX, WIDTH_PX), r"c02\.png: has two grey levels only: it is a mask"),
        ("c02.png", np.zeros((WIDTH_PX, HEIGHT_PX), np.uint8), r"c02\.png: has 48x64 pixels; .* 64x48"),
        ("c99.png", np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8), r"c99\.png: 'c99' is no camera of the rig"),
        ("c02.png", None, r"c02\.png: is not a sound PNG"),
        ("c02.PNG", np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8), r"c02\.\w+: is a second image of camera c02"),
        ("c02.tif", np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8), r"c02\.tif: is a second image of camera c02"),
    ],
)
def test_wrong_images_are_named_and_nothing_is_written(
    source: Path, tmp_path: Path, name: str, image: np.ndarray | None, message: str
) -> None:
    content = (
        (source / "stone 4" / "c02.png").read_bytes()[:-100]
        if image is None
        else imagecodecs.png_encode(image.astype(np.uint8))
    )
    (source / "stone 4" / name).write_bytes(content)
    before = set(tmp_path.iterdir())
    with pytest.raises(RecordingError, match=message):
        import_command(source, tmp_path / "rec", tmp_path / "rig.json", ["empty"])
    assert set(tmp_path.iterdir()) == before


def test_wrong_folders_are_named(source: Path, tmp_path: Path) -> None:
    rig, out = tmp_path / "rig.json", tmp_path / "rec"
    with pytest.raises(UsageError, match=r"background nothing: .* has no such folder"):
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


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_backgrounds_may_be_listed_by_any_editor(source: Path, tmp_path: Path, encoding: str) -> None:
    (source / "empty").rename(source / "größte")
    (source / "backgrounds.txt").write_bytes("größte \r\n\r\n".encode(encoding))
    import_command(source, tmp_path / "rec", tmp_path / "rig.json", None)
    kinds = [header.kind for header in playback_order(open_recording(tmp_path / "rec"))]
    assert kinds.count(BundleKind.BACKGROUND) == 1


def test_what_systems_leave_is_skipped_and_other_files_are_named(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    apple_double = b"\0\5\x16\7\0\2\0\0Mac OS X        "
    (source / "__MACOSX" / "stone 1").mkdir(parents=True)
    for left in ("__MACOSX/stone 1/._c01.png", "stone 1/._c01.png", "stone 1/.DS_Store", "stone 2/Thumbs.db"):
        (source / left).write_bytes(apple_double)
    (source / "stone 4" / "c02.png").rename(source / "stone 4" / "c02.jpg")
    (source / "c01.png").write_bytes(b"")
    (source / "stone 5" / "more").mkdir()
    for exported in ("rig.json", "backgrounds.txt"):
        (source / exported).write_text("")
    import_command(source, tmp_path / "rec", tmp_path / "rig.json", ["empty"])
    said = capsys.readouterr().err
    assert re.findall(r"left out: (?:.*/images/)?(.*)", said) == [
        "c01.png",
        "stone 4/c02.jpg",
        "stone 5/more",
    ]
    assert "3 left out" in said
    recording = open_recording(tmp_path / "rec")
    assert len(recording.headers) == 11
    fourth = read_bundle(playback_order(recording)[4].path, recording.camera_ids)
    assert dict(fourth.missing) == {CAMERAS[1]: "no_image"}


@pytest.mark.parametrize("bits", [12, 16])
def test_deep_images_keep_their_upper_bits_and_their_depth_is_told(
    source: Path, tmp_path: Path, bits: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each image again as a TIFF of 16 bits that holds `bits`, low bits at random: the same recording."""
    import_command(source, tmp_path / "expected", tmp_path / "rig.json", ["empty"])
    rng = np.random.default_rng(1)
    for path in sorted(source.rglob("*.png")):
        shift = bits - 8
        deep = imagecodecs.png_decode(path.read_bytes()).astype(np.uint16) << shift
        tifffile.imwrite(
            path.with_suffix(".tif"), deep | rng.integers(1 << shift, size=deep.shape, dtype=np.uint16)
        )
        path.unlink()
    if bits == 12:
        with pytest.raises(RecordingError, match=r"without a grey level above 40\d\d: .*--bits 12"):
            import_command(source, tmp_path / "rec", tmp_path / "rig.json", ["empty"])
        assert not (tmp_path / "rec").exists()
    capsys.readouterr()
    import_command(
        source, tmp_path / "rec", tmp_path / "rig.json", ["empty"], bits=None if bits == 16 else bits
    )
    assert f"43 images of {bits} bits: the upper 8 are kept" in capsys.readouterr().err
    found, expected = (open_recording(tmp_path / name) for name in ("rec", "expected"))
    for one, other in zip(playback_order(found), playback_order(expected), strict=True):
        images, wanted = (read_bundle(each.path, found.camera_ids).frames for each in (one, other))
        assert all(np.array_equal(images[camera].image, wanted[camera].image) for camera in wanted)
    with pytest.raises(RecordingError, match=r"c\d\d\.tif: has grey level \d+, which is more than 10 bits"):
        import_command(source, tmp_path / "more", tmp_path / "rig.json", ["empty"], bits=10)


def test_cameras_of_another_program_are_placed_and_described(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Matrices in inches around another origin, without a size of images: the rig of the images again."""
    origin_in = np.array([1.0, -2.0, 0.5])
    lines = []
    for camera in small_rig().cameras:
        t_in = camera.t_mm / 25.4 - camera.R @ origin_in
        lines.append(f"{camera.id}.png {' '.join(map(str, (camera.K @ np.c_[camera.R, t_in]).ravel()))}")
    matrices = tmp_path / "p.txt"
    matrices.write_text("\n".join(lines))
    for number, origin in enumerate(("1,-2,0.5", "axes")):
        out = tmp_path / f"rec{number}"
        import_command(source, out, matrices, ["empty"], mm_per_unit=25.4, origin=origin)
        rig = open_recording(out).rig
        assert rig is not None
        assert "4 cameras, 25.4 mm a unit" in (said := capsys.readouterr().err)
        assert "300.0 to 300.0 mm from it, which their axes pass by 0.00 mm at most" in said
        assert "images there are 61.4 to 61.4 mm wide" in said
        for found, expected in zip(rig.cameras, small_rig().cameras, strict=True):
            assert found.image_size_px == SIZE_PX
            assert np.allclose(found.projection, expected.projection, atol=1e-6)
    with pytest.raises(RecordingError, match=r"is 12 mm from the origin \(1 mm a unit, origin 0,0,0\)"):
        import_command(source, tmp_path / "no", matrices)
    with pytest.raises(UsageError, match=r"is a rig file, in mm: leave --mm-per-unit and --origin out"):
        import_command(source, tmp_path / "no", tmp_path / "rig.json", origin="axes")
    with pytest.raises(typer.BadParameter, match=r"'1,2' is neither X,Y,Z nor axes"):
        import_command(source, tmp_path / "no", matrices, origin="1,2")
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize(("body", "wall"), [(255, 0), (0, 255), (1, 0), (30, 200)])
def test_masks_are_imported_as_such_whichever_level_is_the_body(
    source: Path, tmp_path: Path, body: int, wall: int
) -> None:
    v, u = np.mgrid[:HEIGHT_PX, :WIDTH_PX]
    is_body = np.hypot(u - 30, v - 20) < 10
    for path in source.rglob("*.png"):
        is_empty = path.parent.name == "empty"
        write_png(path, np.where(is_body & ~is_empty, body, wall).astype(np.uint8))
    with pytest.raises(RecordingError, match="it is a mask, not a photograph; `import --masks`"):
        import_command(source, tmp_path / "rec", tmp_path / "rig.json")
    import_command(source, tmp_path / "rec", tmp_path / "rig.json", masks=True)
    with pytest.raises(RecordingError, match="holds masks, not photographs"):
        open_recording(tmp_path / "rec")
    recording = open_recording(tmp_path / "rec", takes_masks=True)
    for header in recording.headers:
        expected = is_body & (header.name != "empty")
        for frame in read_bundle(header.path, recording.camera_ids).frames.values():
            assert np.array_equal(frame.image, np.where(expected, 255, 0))
    write_png(source / "stone 1" / "c01.png", tagged_image(1, CAMERAS[0]))
    with pytest.raises(RecordingError, match=r"c01\.png: has more than two grey levels"):
        import_command(source, tmp_path / "more", tmp_path / "rig.json", masks=True)


def test_the_command_lines(source: Path, tmp_path: Path) -> None:
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
