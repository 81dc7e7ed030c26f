import logging
from pathlib import Path

import numpy as np
import pytest

from pipeline.frames import CameraId
from pipeline.segmentation.background import CameraBackground
from service.processing import backgrounds
from service.processing.backgrounds import KeptBackground, read_background, write_background

SIZES = {CameraId("c01"): (5, 4)}
OTHER_SIZES = {CameraId("c01"): (5, 6)}
RIG = ["cameras", 20.0]


def background(path: Path, grey: float) -> Path:
    mean = np.full((4, 5), grey, np.float32)
    write_background(path, {CameraId("c01"): CameraBackground(mean=mean, n_frames=3, n_refused=0)})
    return path


@pytest.fixture
def store(tmp_path: Path) -> Path:
    (folder := tmp_path / "store").mkdir()
    return folder


def test_what_was_kept_is_restored_after_a_restart(tmp_path: Path, store: Path):
    assert KeptBackground(store, SIZES, RIG).restore(tmp_path / "none") is None
    KeptBackground(store, SIZES, RIG).keep(background(tmp_path / "seen", 200))
    restored = KeptBackground(store, SIZES, RIG).restore(tmp_path / "restored")
    assert restored == tmp_path / "restored"
    assert read_background(restored)[CameraId("c01")].mean[0, 0] == 200


def test_what_an_earlier_release_kept_is_restored(tmp_path: Path, store: Path):
    KeptBackground(store, SIZES, RIG).keep(background(tmp_path / "seen", 200))
    (file,) = store.iterdir()
    mean = np.arange(20, dtype=np.float32).reshape(4, 5)
    np.savez(file, **{"c01": mean, "c01.counts": np.array([2, 0])})
    restored = KeptBackground(store, SIZES, RIG).restore(tmp_path / "restored")
    assert restored is not None
    assert np.array_equal(read_background(restored)[CameraId("c01")].mean, mean)


def test_another_rig_starts_without_and_replaces_it(tmp_path: Path, store: Path):
    KeptBackground(store, SIZES, RIG).keep(background(tmp_path / "seen", 200))
    other = KeptBackground(store, SIZES, ["cameras", 10.0])
    assert other.restore(tmp_path / "restored") is None
    other.keep(background(tmp_path / "darker", 100))
    assert KeptBackground(store, SIZES, RIG).restore(tmp_path / "restored") is None
    assert KeptBackground(store, OTHER_SIZES, ["cameras", 10.0]).restore(tmp_path / "r") is None
    same = KeptBackground(store, SIZES, ["cameras", 10.0])
    assert same.restore(tmp_path / "restored") is not None
    assert len(list(store.iterdir())) == 1


def test_it_is_not_written_with_every_exposure(tmp_path: Path, store: Path, monkeypatch: pytest.MonkeyPatch):
    kept = KeptBackground(store, SIZES, RIG)
    for grey, every_s, expected in ((200, 600.0, 200), (150, 600.0, 200), (100, 0.0, 100)):
        monkeypatch.setattr(backgrounds, "KEEP_EVERY_S", every_s)
        kept.keep(background(tmp_path / f"{grey}", grey))
        restored = KeptBackground(store, SIZES, RIG).restore(tmp_path / "restored")
        assert restored is not None
        assert read_background(restored)[CameraId("c01")].mean[0, 0] == expected


@pytest.mark.parametrize(
    "damage", [lambda data: data[: len(data) // 2], lambda data: b"", lambda data: b"x" * 99]
)
def test_a_damaged_one_is_not_used(tmp_path: Path, store: Path, damage, caplog: pytest.LogCaptureFixture):
    KeptBackground(store, SIZES, RIG).keep(background(tmp_path / "seen", 200))
    (file,) = store.iterdir()
    file.write_bytes(damage(file.read_bytes()))
    assert KeptBackground(store, SIZES, RIG).restore(tmp_path / "restored") is None
    assert not (tmp_path / "restored").exists()
    assert str(file) in caplog.text


def test_a_store_that_cannot_be_written_costs_only_this(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    caplog.set_level(logging.ERROR)
    KeptBackground(tmp_path / "gone", SIZES, RIG).keep(background(tmp_path / "seen", 200))
    assert "not kept for the next start" in caplog.text
