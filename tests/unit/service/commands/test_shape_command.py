"""`stonefall shape` on good and damaged mesh files."""

import json
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import pytest
import trimesh
import typer
from typer.testing import CliRunner, Result

from pipeline.measuring import ShapeMeasurement, measure_shape
from service.commands.shape import command

BOX = trimesh.creation.box([5, 20, 40])


def shape(*arguments: str | Path) -> Result:
    app = typer.Typer()
    app.command()(command)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "STL"])
def test_each_format_measures_the_same(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"box.{suffix}"
    BOX.export(path, file_type=suffix.lower())
    result = shape(path, "--json")
    assert result.exit_code == 0
    (measured,) = json.loads(result.stdout)
    assert measured["file"] == str(path)
    assert set(measured) == {"file"} | {field.name for field in fields(ShapeMeasurement)}
    expected = asdict(measure_shape(BOX.vertices, BOX.faces))
    for name, value in expected.items():
        assert measured[name] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-4)), name


def test_table_shows_every_mesh(tmp_path: Path) -> None:
    paths = [tmp_path / f"box{i}.ply" for i in range(4)]
    for path in paths:
        BOX.export(path)
    result = shape(*paths)
    assert result.exit_code == 0
    for path in paths:
        assert path.name in result.stdout
    assert result.stdout.count("17.678") == 4
    assert result.stderr == ""


def test_texture_seams_do_not_open_a_mesh(tmp_path: Path) -> None:
    """Each face has texture coordinates of its own; trimesh splits vertices there."""
    lines = [f"v {x} {y} {z}" for x, y, z in BOX.vertices]
    lines += [f"vt {i / 36} 0.5" for i in range(36)]
    for i, face in enumerate(BOX.faces + 1):
        lines.append("f " + " ".join(f"{vertex}/{3 * i + k}" for k, vertex in enumerate(face, start=1)))
    path = tmp_path / "seams.obj"
    path.write_text("\n".join(lines))
    (measured,) = json.loads(shape(path, "--json").stdout)
    assert measured["volume_mm3"] == pytest.approx(4000)


def test_ascii_stl(tmp_path: Path) -> None:
    path = tmp_path / "box.stl"
    path.write_text(trimesh.exchange.stl.export_stl_ascii(BOX))
    (measured,) = json.loads(shape(path, "--json").stdout)
    assert measured["sieve_size_mm"] == pytest.approx(17.678, rel=1e-3)


PLY = trimesh.exchange.ply.export_ply(BOX)
STL = trimesh.exchange.stl.export_stl(BOX)
ASCII_PLY = trimesh.exchange.ply.export_ply(BOX, encoding="ascii")
ASCII_STL = trimesh.exchange.stl.export_stl_ascii(BOX).encode()
OBJ = trimesh.exchange.obj.export_obj(BOX).encode()
NOISE = np.random.default_rng(0).bytes(500)


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("open.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not closed"),
        ("empty.stl", b"", "no faces"),
        ("empty.ply", b"", "damaged"),
        ("empty.obj", b"", "no faces"),
        ("cut.ply", PLY[:-20], "damaged"),
        ("head.ply", PLY[:100], "damaged"),
        ("cut.stl", STL[:300], "damaged"),
        ("noise.stl", NOISE, "damaged"),
        ("noise.ply", NOISE, "damaged"),
        ("noise.obj", NOISE, "damaged"),
        ("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "damaged"),
        ("words.obj", b"v a b c\nf 1 2 3\n", "damaged"),
        ("nan.obj", b"v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "not finite"),
        ("far.obj", OBJ.replace(b"v -2.5", b"v -2.5\n", 1), "damaged"),
        ("list.ply", ASCII_PLY.replace(b"property list", b"property lost"), "damaged"),
        ("model.glb", b"glTF", "must be one of .stl, .ply, .obj"),
        ("missing.stl", None, "No such file"),
    ],
)
def test_bad_file_is_one_line_and_the_others_are_measured(
    tmp_path: Path, name: str, content: bytes | None, problem: str, caplog: pytest.LogCaptureFixture
) -> None:
    good, bad = tmp_path / "good.stl", tmp_path / name
    BOX.export(good)
    if content is not None:
        bad.write_bytes(content)

    result = shape(bad, good, "--json")

    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"stonefall: {bad}: ")
    assert problem in line
    assert not caplog.records  # trimesh has tracebacks of its own
    assert [measured["file"] for measured in json.loads(result.stdout)] == [str(good)]


def test_normals_that_cannot_be_read_do_not_matter(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "normal.stl"
    path.write_bytes(ASCII_STL.replace(b"normal", b"normal x", 1))
    (measured,) = json.loads(shape(path, "--json").stdout)
    assert measured["volume_mm3"] == pytest.approx(4000)
    assert not caplog.records  # trimesh would show a traceback


def test_of_several_bodies_the_largest_is_measured_and_the_others_are_told(tmp_path: Path) -> None:
    path = tmp_path / "scan.stl"
    crumb = trimesh.creation.icosphere(subdivisions=3, radius=0.25)
    crumb.apply_translation([60, 0, 0])
    patch = trimesh.Trimesh(crumb.vertices + 5, crumb.faces[:100], process=False)  # open, as scans have them
    trimesh.util.concatenate([crumb, BOX, patch]).export(path)
    result = shape(path, "--json")
    assert result.exit_code == 0
    (measured,) = json.loads(result.stdout)
    assert (measured["volume_mm3"], measured["convexity"]) == (pytest.approx(4000), pytest.approx(1))
    assert result.stderr == f"stonefall: {path}: warning: of 3 bodies only the largest is measured\n"


@pytest.mark.parametrize(
    ("factor", "told"),
    [
        (
            0.001,
            "is 0.045 mm long, is it in mm?; if in metres, scale it by 1000 to 45 mm; if in inches, scale it by",
        ),
        (1 / 25.4, None),
        (
            0.02,
            "is 0.9 mm long, is it in mm?; if in inches, scale it by 25.4 to 22.9 mm; if in centimetres, scale",
        ),
        (1000, "is 45000 mm long, is it in mm?; if in micrometres, scale it by 0.001 to 45 mm"),
        (5, "is 225 mm long, is it in mm?\n"),
    ],
)
def test_a_length_that_no_stone_has_is_doubted(tmp_path: Path, factor: float, told: str | None) -> None:
    path = tmp_path / "scan.ply"
    trimesh.Trimesh(BOX.vertices * factor, BOX.faces, process=False).export(path)
    result = shape(path, "--json")
    assert result.exit_code == 0
    assert (told or "") in result.stderr and bool(result.stderr) == (told is not None)


def test_usage() -> None:
    assert shape().exit_code == 2
