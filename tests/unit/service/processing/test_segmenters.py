"""Which segmenter a configuration comes to, and what is left of it without its model."""

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.networks import darkness_network, difference_network

from pipeline.frames import CameraId, Frame
from pipeline.segmentation import ViewStatus, segmenter_choice
from pipeline.segmentation.subtraction import SegmentationParameters
from service.base.errors import SettingsError
from service.configuration.segmentation_settings import SegmentationSettings, plan_segmenter
from service.configuration.settings import Settings, load_settings, shortcomings
from service.processing.segmenters import CLASSICAL, SegmenterPlan, build_segmenter, warm_up

Load = Callable[[str], Settings]
PARAMETERS = SegmentationParameters()


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """Settings with this section on segmentation."""

    def settings_with(section: str) -> Settings:
        path = tmp_path / "stonefall.toml"
        path.write_text(
            f'[rig]\nrecording = "r"\n[spool]\ndir = "s"\n[store]\ndir = "t"\n[segmentation]\n{section}\n'
        )
        return load_settings(path)

    return settings_with


def stone() -> Frame:
    v, u = np.mgrid[:256, :320]
    image = np.where(np.hypot(u - 160, v - 128) < 50, 60, 200).astype(np.uint8)
    return Frame(camera=CameraId("c01"), image=image, frame_id=1, device_ns=0, received_ns=0)


def test_the_section_holds_the_pipeline_s_parameters_and_which_segmenter(load: Load, tmp_path: Path):
    assert load("").segmentation == SegmentationSettings()
    settings = load('min_contrast = 0.2\nsegmenter = "onnx"\nmodel = "nets/mine.onnx"')
    assert settings.pipeline.segmentation == SegmentationParameters(min_contrast=0.2)
    assert settings.segmentation.segmenter == "onnx"
    assert settings.segmentation.model == str(tmp_path / "nets/mine.onnx")
    assert load('model = "nets/mine"').segmentation.model == str(tmp_path / "nets/mine")
    assert load('model = "u2netp"').segmentation.model == "u2netp"
    with pytest.raises(
        SettingsError, match=r"segmentation\.segmenter: .*'auto', 'background', 'onnx' or 'mask'"
    ):
        load('segmenter = "best"')
    with pytest.raises(SettingsError, match="min_contrast must be between 0 and 1"):
        load("min_contrast = 2")


def test_the_built_in_model_is_there(load: Load):
    plan = plan_segmenter(SegmentationSettings())
    assert (plan.wanted, plan.trouble, plan.warning) == ("auto", None, None)
    assert plan.model
    assert list(shortcomings(load(""))) == []


def test_a_model_that_cannot_be_used_is_named_and_does_without(load: Load, tmp_path: Path):
    damaged = tmp_path / "damaged.onnx"
    damaged.write_bytes(difference_network()[:100])
    for name in ("missing.onnx", "damaged.onnx"):
        settings = load(f'model = "{name}"')
        plan = plan_segmenter(settings.segmentation)
        assert plan.model is None
        assert plan.warning is not None
        assert plan.warning.startswith(f"classical mode: {tmp_path / name}: ")
        assert list(shortcomings(settings)) == [f"segmentation.model: {plan.trouble}"]
        found = build_segmenter(plan, PARAMETERS)(stone(), {})
        assert (found.status, found.fallback) == (ViewStatus.NO_BACKGROUND, "no background yet; no model")


def test_a_processor_that_is_not_there_is_named_before_the_start(load: Load):
    settings = load('providers = ["NoSuchProvider", "CPUExecutionProvider"]')
    plan = plan_segmenter(settings.segmentation)
    assert plan.model
    assert plan.warning is not None
    assert plan.warning.startswith("this onnxruntime has no NoSuchProvider, but ")
    assert list(shortcomings(settings)) == [f"segmentation.providers: {plan.warning}"]


def test_a_worker_that_cannot_load_what_others_could_does_without(caplog: pytest.LogCaptureFixture):
    segmenter = build_segmenter(SegmenterPlan(wanted="onnx", model=b"damaged"), PARAMETERS)
    assert segmenter.network is None
    assert "classical mode: expected an ONNX model" in caplog.text


def test_a_processor_that_is_not_there_is_replaced_and_told(caplog: pytest.LogCaptureFixture):
    with caplog.at_level(logging.WARNING):
        plan = SegmenterPlan(wanted="onnx", model=difference_network(), providers=("NoSuchProvider",))
        segmenter = build_segmenter(plan, PARAMETERS)
    assert "NoSuchProvider" in caplog.text
    assert segmenter(stone(), {}).found_by == "network"


def test_without_a_network_the_comparison_alone_is_made_ready(monkeypatch: pytest.MonkeyPatch):
    called: list[str] = []
    monkeypatch.setattr(
        segmenter_choice, "warm_up", lambda: called.append("all kernels, see test_delineation")
    )
    warm_up(build_segmenter(CLASSICAL, PARAMETERS))
    assert called


def test_a_mask_decides_alone_and_its_absence_is_said_with_each_view(load: Load, tmp_path: Path):
    plan = SegmenterPlan(wanted="mask", model=darkness_network())
    segmenter = build_segmenter(plan, PARAMETERS)
    warm_up(segmenter)
    assert segmenter(stone(), {}).found_by == "u2net"
    without = build_segmenter(SegmenterPlan(wanted="mask", trouble="no file"), PARAMETERS)
    assert without(stone(), {}).fallback == "no background yet; no model"
    (tmp_path / "ours.onnx").write_bytes(difference_network())
    refused = plan_segmenter(load(f'segmenter = "mask"\nmodel = "{tmp_path}/ours.onnx"').segmentation)
    assert "segmenter mask needs a U2-Net as model" in (refused.trouble or "")


def test_a_plan_becomes_the_segmenter_it_says():
    assert build_segmenter(CLASSICAL, PARAMETERS).network is None
    segmenter = build_segmenter(SegmenterPlan(wanted="auto", model=difference_network()), PARAMETERS)
    warm_up(segmenter)
    found = segmenter(stone(), {})
    assert (found.status, found.found_by, found.fallback) == (
        ViewStatus.OK,
        "network",
        "no background yet",
    )
    radius_px = np.hypot(*(found.outline_uv - [160, 128]).T)
    assert radius_px.mean() == pytest.approx(50, abs=0.5)
