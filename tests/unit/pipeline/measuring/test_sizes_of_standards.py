"""Extremes over directions, of bodies whose sizes are known exactly, are not those of the noise."""

import numpy as np
import pytest
from support.rendered import background, rig, tumbled_bundle

from pipeline.particle import PipelineParameters, measure_bundle
from pipeline.segmentation.subtraction import BackgroundSegmenter

TRUE_MM = {
    # sieve size, maximum and minimum Feret diameter
    "sphere": (15.0, 15.0, 15.0),
    "ball": (10.0, 10.0, 10.0),
    "cylinder": (15.0, 15 * np.sqrt(2), 15.0),
    "cube": (15.0, 15 * np.sqrt(3), 15.0),
}
BAR_MM = 0.036  # of a single pose, which the highest of what chance puts on faces decides


@pytest.mark.parametrize(
    ("name", "number"),
    [("sphere", 0), ("cube", 0)]
    + [
        pytest.param(name, number, marks=pytest.mark.full)
        for name in TRUE_MM
        for number in range(4)
        if (name, number) not in {("sphere", 0), ("cube", 0)}
    ],
)
def test_sizes_are_those_of_the_body(name: str, number: int) -> None:
    result = measure_bundle(
        tumbled_bundle(name, number), rig(), background(), BackgroundSegmenter(), PipelineParameters()
    )
    assert result.measurement is not None
    shape = result.measurement.shape
    errors_mm = np.subtract((shape.sieve_size_mm, shape.max_feret_mm, shape.min_feret_mm), TRUE_MM[name])
    assert (np.abs(errors_mm) < BAR_MM).all(), errors_mm
