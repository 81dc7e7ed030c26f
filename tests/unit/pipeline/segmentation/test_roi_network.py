"""The shipped network: its checksum and size, and that it finds bodies in views it never saw."""

import hashlib
import json
from functools import cache
from importlib.resources import files

import numpy as np
import onnx
import pytest

from pipeline.evaluation.hard_cases import HardCase
from pipeline.segmentation.network import FORMAT, load_network
from pipeline.training.scores import Score, ValidationView, score, validation_view

MODEL = files("pipeline.segmentation").joinpath("roi_network.onnx")
DESCRIPTION = files("pipeline.segmentation").joinpath("roi_network.json")
SEED = 8_000_001
"""Used neither for training nor for the scores that came with the training."""


@cache
def content() -> bytes:
    return MODEL.read_bytes()


def scored(one: ValidationView) -> Score:
    (found,) = score([one], load_network(content()).probability).values()
    return found


def test_the_file_is_the_one_that_was_described() -> None:
    description = json.loads(DESCRIPTION.read_text(encoding="utf-8"))
    metadata = load_network(content()).metadata
    assert description["sha256"] == hashlib.sha256(content()).hexdigest()
    assert metadata["format"] == FORMAT
    assert json.loads(metadata["metrics"]) == description["metrics"]
    assert int(metadata["seed"]) == description["seed"]
    assert set(description["metrics"]) >= set(HardCase)


def test_it_is_small() -> None:
    weights = onnx.load_from_string(content()).graph.initializer
    # where the network computes in blocks its parameters repeat, between zeros
    n_parameters = sum(len(np.unique(onnx.numpy_helper.to_array(weight))) for weight in weights)
    described = json.loads(DESCRIPTION.read_text(encoding="utf-8"))["n_parameters"]
    assert len(content()) < 1_000_000
    # a folded batch normalization leaves one number a channel of its two
    assert 0.95 * described < n_parameters <= described <= 200_000


@pytest.mark.parametrize(
    ("case", "least_iou"),
    [
        (HardCase.CLEAN, 0.97),
        (HardCase.DUST, 0.96),
        (HardCase.DIMMED, 0.94),
        (HardCase.APERTURE, 0.94),
        (HardCase.F2, 0.96),
        (HardCase.DEFOCUS, 0.94),
        (HardCase.NOISE_10, 0.95),
        (HardCase.MOTION_9, 0.94),
    ],
)
def test_it_finds_the_body(case: HardCase, least_iou: float) -> None:
    found = scored(validation_view(case, SEED))
    assert found.iou > least_iou
    assert found.surely_wrong < 0.002


def test_it_finds_the_body_without_a_background() -> None:
    assert scored(validation_view(HardCase.CLEAN, SEED, with_background=False)).iou > 0.96
