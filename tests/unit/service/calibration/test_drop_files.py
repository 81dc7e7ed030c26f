from pathlib import Path

import numpy as np
from support.ball_drops import drop
from support.calibration_desk import a_drop

from pipeline.rig.design import nominal_rig
from service.calibration.drop_files import keep_drop, kept_drops, outline_paths, read_drop, write_drop


def test_what_is_written_is_read(tmp_path: Path):
    written = drop("000007-ball", nominal_rig(), (1.0, -2.0, 3.0), 10.0, fall_ns=247_000_000)
    write_drop(tmp_path / "drop.npz", written)
    found = read_drop(tmp_path / "drop.npz")
    assert (found.name, found.diameter_mm, found.fall_ns) == ("000007-ball", 10.0, 247_000_000)
    assert found.refused == written.refused
    assert list(found.views) == list(written.views)
    for camera, view in written.views.items():
        assert np.array_equal(found.views[camera].outline_uv, view.outline_uv)
        assert np.array_equal(found.views[camera].center_uv, view.center_uv)
        assert found.views[camera].radius_px == view.radius_px


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
