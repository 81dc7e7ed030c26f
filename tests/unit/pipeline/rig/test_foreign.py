"""A rig written as other programs write it, by code of the tests alone, and read back."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import RecordingError
from drivers.files.rig_file import is_rig_file, read_foreign_rig, write_rig
from pipeline.arrays import PointsMM, PointsUV
from pipeline.errors import RigError
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.rig.foreign import camera_name, from_matrices
from pipeline.rig.placing import Placement, placed_rig

PLACEMENT = Placement(mm_per_unit=25.4, origin=(1.5, -0.25, 3.0))
SIZE_PX = (1280, 1024)
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
POINTS_MM: PointsMM = np.random.default_rng(3).uniform(-20, 20, (50, 3))


def bent(rig: RigCalibration) -> RigCalibration:
    """Return the rig with all coefficients of distortion, large enough that each moves pixels."""
    rng = np.random.default_rng(1)
    cameras = (
        replace(each, distortion=np.array([-0.1, 0.3, 2e-3, -1e-3, 0.8]) * rng.uniform(0.5, 1, 5))
        for each in rig.cameras
    )
    return replace(rig, cameras=tuple(cameras))


RIG = bent(as_built(nominal_rig(), seed=5))
STRAIGHT = replace(RIG, cameras=tuple(replace(each, distortion=np.zeros(5)) for each in RIG.cameras))


def in_file(points_mm: PointsMM) -> PointsMM:
    """Return points in the world of the file."""
    return points_mm / PLACEMENT.mm_per_unit + np.array(PLACEMENT.origin)


def t_in_file(camera: CameraCalibration) -> np.ndarray:
    return camera.t_mm / PLACEMENT.mm_per_unit - camera.R @ np.array(PLACEMENT.origin)


def write_colmap(folder: Path, rig: RigCalibration) -> None:
    folder.mkdir()
    cameras, images = ["# Camera list"], ["# Image list with two lines of data per image:"]
    for number, camera in enumerate(rig.cameras, 1):
        (fx, _, cx), (_, fy, cy), _ = camera.K
        values = [fx, fy, cx + 0.5, cy + 0.5, *camera.distortion, 0, 0, 0]
        cameras.append(f"{number} FULL_OPENCV 1280 1024 " + " ".join(map(repr, map(float, values))))
        x, y, z, w = Rotation.from_matrix(camera.R).as_quat()
        pose = " ".join(repr(float(value)) for value in (w, x, y, z, *t_in_file(camera)))
        points = "" if number % 2 else "100.5 200.5 -1 7 8 9 10.25 11.5 12 300.0 400.0 13"
        images += [f"{number} {pose} {number} stone 1/{camera.id}.png", points]
    (folder / "cameras.txt").write_text("\n".join(cameras))
    (folder / "images.txt").write_text("\n".join(images))


def write_blender(path: Path, rig: RigCalibration, of_all: Mapping[str, Any]) -> None:
    frames = []
    for camera in rig.cameras:
        (fx, _, cx), (_, fy, cy), _ = camera.K
        pose = np.eye(4)
        pose[:3, :3] = camera.R.T @ np.diag([1, -1, -1])
        pose[:3, 3] = in_file(camera.center_mm)
        lens = {"fl_x": fx, "fl_y": fy, "cx": cx + 0.5, "cy": cy + 0.5, "w": 1280, "h": 1024}
        lens |= dict(zip(COEFFICIENTS, camera.distortion.tolist(), strict=True))
        kept = {key: value for key, value in lens.items() if key not in of_all}
        frames.append({"file_path": f".\\train/{camera.id}", "transform_matrix": pose.tolist(), **kept})
    path.write_text(json.dumps({**of_all, "frames": frames}))


def write_opencv(folder: Path, rig: RigCalibration, suffix: str = "yml") -> None:
    folder.mkdir()
    for number, camera in enumerate(rig.cameras):
        storage = cv2.FileStorage(str(folder / f"{camera.id}.{suffix}"), cv2.FILE_STORAGE_WRITE)
        storage.write("camera_matrix", camera.K)
        further = np.zeros(3 if number % 2 else 0)
        storage.write("distortion_coefficients", np.append(camera.distortion, further))
        if number % 2:
            storage.write("R", camera.R)
        else:
            storage.write("rvec", cv2.Rodrigues(camera.R)[0])
        storage.write("T", t_in_file(camera))
        storage.write("image_width", 1280)
        storage.write("image_height", 1024)
        storage.release()


def write_projections(path: Path, rig: RigCalibration) -> None:
    lines = (
        f"{camera.id} " + " ".join(map(repr, -3 * (camera.K @ np.c_[camera.R, t_in_file(camera)]).ravel()))
        for camera in rig.cameras
    )
    path.write_text("# name P\n" + "\n".join(line.replace("np.float64", "") for line in lines))


def write_middlebury(path: Path, rig: RigCalibration) -> None:
    lines = [f"{len(rig.cameras)}"]
    for camera in rig.cameras:
        values = (*camera.K.ravel(), *camera.R.ravel(), *t_in_file(camera))
        lines.append(" ".join([f"{camera.id}.png", *(f"{value:.17g}" for value in values)]))
    path.write_text("\n".join(lines), encoding="utf-8-sig")


def assert_same_rig(found: RigCalibration, expected: RigCalibration) -> None:
    assert found.camera_ids == expected.camera_ids
    for one, other in zip(found.cameras, expected.cameras, strict=True):
        assert one.image_size_px == other.image_size_px
        assert pytest.approx(other.K, rel=1e-9, abs=1e-7) == one.K
        assert one.distortion == pytest.approx(other.distortion, abs=1e-12)
        assert pytest.approx(other.R, abs=1e-9) == one.R
        assert one.t_mm == pytest.approx(other.t_mm, abs=1e-6)
        for pixels, wanted in zip(one.project(POINTS_MM), other.project(POINTS_MM), strict=True):
            assert pixels == pytest.approx(wanted, abs=1e-5)


@pytest.mark.parametrize(
    ("name", "write", "rig"),
    [
        ("colmap", write_colmap, RIG),
        ("transforms.json", lambda path, rig: write_blender(path, rig, {"camera_model": "OPENCV"}), RIG),
        ("transforms.json", lambda path, rig: write_blender(path, rig, {"w": 1280.0, "h": 1024}), RIG),
        ("opencv", write_opencv, RIG),
        ("opencv", lambda path, rig: write_opencv(path, rig, "xml"), RIG),
        ("projections.txt", write_projections, STRAIGHT),
        ("par.txt", write_middlebury, STRAIGHT),
    ],
)
def test_a_rig_in_the_form_of_another_program_is_read_back(
    tmp_path: Path, name: str, write: Callable[[Path, RigCalibration], None], rig: RigCalibration
) -> None:
    write(tmp_path / name, rig)
    assert not is_rig_file(tmp_path / name)
    assert_same_rig(read_foreign_rig(tmp_path / name, SIZE_PX, PLACEMENT), rig)


def colmap_pixels(line: str, pose: str, points: PointsMM) -> PointsUV:
    """Project as the comments of COLMAP's models say, from the corner of the image."""
    fx, fy, cx, cy, k1, k2, p1, p2 = map(float, line.split()[4:12])
    k3 = float(line.split()[12])
    w, x, y, z, *t = map(float, pose.split()[1:8])
    seen = Rotation.from_quat([x, y, z, w]).apply(points) + t
    u, v = (seen[:, :2] / seen[:, 2:]).T
    r2 = u * u + v * v
    radial = k1 * r2 + k2 * r2**2 + k3 * r2**3
    du = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    dv = v * radial + 2 * p2 * u * v + p1 * (r2 + 2 * v * v)
    return np.column_stack([fx * (u + du) + cx, fy * (v + dv) + cy])


def test_pixels_are_half_a_pixel_from_those_of_colmap(tmp_path: Path) -> None:
    write_colmap(tmp_path / "m", RIG)
    lens = (tmp_path / "m/cameras.txt").read_text().splitlines()[1]
    pose = (tmp_path / "m/images.txt").read_text().splitlines()[1]
    expected = colmap_pixels(lens, pose, in_file(POINTS_MM)) - 0.5
    found = read_foreign_rig(tmp_path / "m", SIZE_PX, PLACEMENT).cameras[0]
    assert found.project(POINTS_MM)[0] == pytest.approx(expected, abs=1e-6)


def test_a_camera_of_blender_looks_along_its_negative_z_with_y_up(tmp_path: Path) -> None:
    """A camera by its angle alone, as the synthetic scenes of NeRF: the principal point is the middle of the image."""
    angle = 0.2
    poses = {
        "r_0": (np.eye(3), [0, 0, 3.0]),
        "r_1": (Rotation.from_euler("x", 90, True).as_matrix(), [0, -3, 0]),
    }
    frames = []
    for name, (R, at) in poses.items():
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = R, at
        frames.append({"file_path": f"./train/{name}", "rotation": 0.01, "transform_matrix": pose.tolist()})
    (tmp_path / "t.json").write_text(json.dumps({"camera_angle_x": angle, "frames": frames}))
    rig = read_foreign_rig(tmp_path / "t.json", (800, 600), Placement(mm_per_unit=100))
    above, before = rig.cameras
    focal_px = 400 / np.tan(angle / 2)
    for camera, right_mm, up_mm in ((above, [10, 0, 0], [0, 10, 0]), (before, [10, 0, 0], [0, 0, 10])):
        middle, right, up = camera.project([[0, 0, 0], right_mm, up_mm])[0]
        assert middle == pytest.approx([399.5, 299.5])
        assert right - middle == pytest.approx([focal_px * 10 / 300, 0])
        assert up - middle == pytest.approx([0, -focal_px * 10 / 300])


def test_the_origin_can_be_the_point_nearest_to_the_axes() -> None:
    rig = placed_rig("", from_matrices(middlebury(nominal_rig()), SIZE_PX), replace(PLACEMENT, origin=None))
    for found, expected in zip(rig.cameras, nominal_rig().cameras, strict=True):
        assert found.t_mm == pytest.approx(expected.t_mm, abs=1e-6)


def middlebury(rig: RigCalibration) -> str:
    return "\n".join(
        " ".join(map(str, [each.id, *each.K.ravel(), *each.R.ravel(), *t_in_file(each)]))
        for each in rig.cameras
    )


POSED = f'{{"w": W, "frames": [{{"file_path": "a", "transform_matrix": {np.eye(4).tolist()}}}]}}'
COLMAP_FILES = {
    "cameras.txt": "1 PINHOLE 1280 1024 6250 6250 640 512\n",
    "images.txt": "1 1 0 0 0 0 0 300 1 a.png\n\n2 0 1 0 0 0 0 300 1 b.png\n\n",
}


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"a.txt": "c01 1 2 3"}, r"line 1: must have a name and 12 numbers \(P\) or 21"),
        ({"a.txt": "c01 1 2 x"}, "line 1: must hold numbers"),
        ({"a.txt": "\n# nothing\n"}, "cameras: a visual hull needs at least 2 cameras"),
        ({"a.json": '{"frames": [{"file_path": "a"}]}'}, r"frames\[0\].transform_matrix: is missing"),
        ({"a.json": '{"frames": [1]}'}, r"frames\[0\]: must have a file_path"),
        (
            {"a.json": '{"camera_model": "OPENCV_FISHEYE", "frames": [{"file_path": "a"}]}'},
            "is a fisheye, which no rig has",
        ),
        (
            {
                "a.json": json.dumps(
                    {"fl_x": "9", "frames": [{"file_path": "a", "transform_matrix": np.eye(4).tolist()}]}
                )
            },
            r"frames\[0\].fl_x: must be a number, not '9'",
        ),
        *(
            (
                {"a.json": POSED.replace("W", number)},
                r"frames\[0\].w: must be a number up to 1e\+09",
            )
            for number in ("NaN", "1e999", "-1e999", "1" + 400 * "0")
        ),
        ({"a.json": "{"}, "is not JSON"),
        ({"m/c01.txt": ""}, "has neither cameras.txt of COLMAP"),
        ({"m/c01.yml": "%YAML:1.0\n---\nK: ["}, "c01.yml: is no file of OpenCV"),
        *(
            ({f"m/c01.{suffix}": start + 100_000 * nested}, f"c01.{suffix}: is larger than the file of a")
            for suffix, start, nested in (
                ("yml", "%YAML:1.0\n---\nK: ", "["),
                ("yml", "%YAML:1.0\n---\nK:\n   ", "- "),
                ("yml", '{"K": ', '{"K":'),
                ("xml", '<?xml version="1.0"?><opencv_storage>', "<a>"),
            )
        ),
        *(
            (
                {"m/c01.yml": f"%YAML:1.0\n---\nimage_width: {number}\nimage_height: 9\n"},
                "c01.yml: is no file",
            )
            for number in (".Inf", ".Nan")
        ),
        ({"m/c01.yml": "%YAML:1.0\n---\nK: [1, 2]\nR: [0, 0, 0]\n"}, r"c01.K: must have 9 numbers, not 2"),
        ({"m/c01.yml": "%YAML:1.0\n---\nR: [0, 0, 0]\n"}, "c01.K: is missing"),
        ({f"m/{name}": text.replace("PINHOLE", "FOV") for name, text in COLMAP_FILES.items()}, "not 'FOV'"),
        (
            {f"m/{name}": text.replace(" 6250 640", " 640") for name, text in COLMAP_FILES.items()},
            "4 parameters",
        ),
        (
            {f"m/{name}": text.replace("1 a", "7 a") for name, text in COLMAP_FILES.items()},
            "camera 7 is not in",
        ),
        (
            {f"m/{name}": text.replace("b.png", "x/a.png") for name, text in COLMAP_FILES.items()},
            "'a' occurs twice",
        ),
        (
            {f"m/{name}": text.replace("300", "3") for name, text in COLMAP_FILES.items()},
            "is 3 mm from the origin .1 mm",
        ),
        ({"m/cameras.txt": COLMAP_FILES["cameras.txt"]}, "images.txt: cannot be read"),
        ({"a.txt": "caf\u00e9 nan"}, "line 1: must hold finite numbers"),
    ],
)
def test_what_is_wrong_with_foreign_cameras_is_named(
    tmp_path: Path, files: Mapping[str, str], message: str
) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    first = next(iter(files)).split("/")[0]
    with pytest.raises(RecordingError, match=message):
        read_foreign_rig(tmp_path / first, SIZE_PX, Placement())


@pytest.mark.parametrize("n_coefficients", [4, 5, 8, 12, 14])
def test_as_many_coefficients_as_opencv_gives_are_taken_if_the_further_ones_are_zero(
    n_coefficients: int,
) -> None:
    entries = from_matrices(middlebury(RIG), SIZE_PX)
    given = np.append([-0.1, 0.2, 1e-3, 2e-3, 0.5], np.zeros(9))[:n_coefficients].tolist()
    for entry in entries:
        entry["distortion"] = given
    rig = placed_rig("", entries, PLACEMENT)
    assert rig.cameras[0].distortion.tolist() == [*given, 0.0][:5]
    if n_coefficients > 5:
        entries[2]["distortion"] = [*given[:-1], 0.01]
        with pytest.raises(
            RigError, match=r"cameras\[2\].distortion: has coefficients beyond k1 k2 p1 p2 k3"
        ):
            placed_rig("", entries, PLACEMENT)


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("a/b/c01.png", "c01"),
        ("a\\c01.TIFF", "c01"),
        ("./train/r_0", "r_0"),
        ("0001", "0001"),
        ("c.01", "c.01"),
    ],
)
def test_names_of_images_are_those_of_their_cameras(path: str, name: str) -> None:
    assert camera_name(path) == name


def test_a_rig_file_is_known_as_one(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.json", RIG)
    (tmp_path / "rig.txt").write_bytes((tmp_path / "rig.json").read_bytes())
    (tmp_path / "cut.json").write_bytes((tmp_path / "rig.json").read_bytes()[:100])
    for name in ("rig.json", "rig.txt", "cut.json", "missing"):
        assert is_rig_file(tmp_path / name), name
