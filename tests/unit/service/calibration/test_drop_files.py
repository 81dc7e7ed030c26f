import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from support.ball_drops import drop
from support.calibration_desk import a_drop

from pipeline.rig.design import nominal_rig
from service.calibration.drop_files import HEADER, keep_drop, kept_drops, outline_paths, read_drop, write_drop


def test_what_is_written_is_read(tmp_path: Path):
    written = drop("000007-ball", nominal_rig(), (1.0, -2.0, 3.0), 10.0, fall_ns=247_000_000)
    first = next(iter(written.views))
    written = replace(
        written, views={**written.views, first: replace(written.views[first], edge_sigma_px=1.25)}
    )
    write_drop(tmp_path / "drop.npz", written)
    found = read_drop(tmp_path / "drop.npz")
    assert (found.name, found.diameter_mm, found.fall_ns) == ("000007-ball", 10.0, 247_000_000)
    assert found.refused == written.refused
    assert list(found.views) == list(written.views)
    for camera, view in written.views.items():
        assert np.array_equal(found.views[camera].outline_uv, view.outline_uv)
        assert np.array_equal(found.views[camera].center_uv, view.center_uv)
        assert found.views[camera].radius_px == view.radius_px
        assert found.views[camera].edge_sigma_px == view.edge_sigma_px


def test_drops_of_before_have_no_widths(tmp_path: Path):
    write_drop(tmp_path / "drop.npz", drop("a", nominal_rig(), (0.0, 0.0, 0.0)))
    with np.load(tmp_path / "drop.npz") as file:
        arrays = dict(file)
    header = json.loads(str(arrays[HEADER]))
    for view in header["views"].values():
        del view["edge_sigma_px"]
    np.savez(tmp_path / "drop.npz", **{**arrays, HEADER: np.array(json.dumps(header))})
    assert {view.edge_sigma_px for view in read_drop(tmp_path / "drop.npz").views.values()} == {None}


def test_drops_stay_in_order_and_outlines_alone_are_none(tmp_path: Path):
    write_drop(tmp_path / "a.npz", drop("a", nominal_rig(), (0.0, 0.0, 0.0)))
    (kept := tmp_path / "kept").mkdir()
    for name in ("first", "second"):
        keep_drop(kept, a_drop(name), tmp_path / "a.npz")
    keep_drop(kept, a_drop("third"), None)
    (kept / "00004.npz").touch()  # of a daemon that was killed
    assert [each.bundle for each in kept_drops(kept)] == ["first", "second", "third"]
    assert [path.name for path in outline_paths(kept)] == ["00001.npz", "00002.npz"]
    keep_drop(kept, a_drop("fourth"), None)
    assert [path.name for path in outline_paths(kept)] == ["00001.npz", "00002.npz"]
    keep_drop(kept, a_drop("fifth"), tmp_path / "a.npz")
    assert read_drop(outline_paths(kept)[-1]).name == "a"
