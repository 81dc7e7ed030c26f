"""What of a hull no outline bounds: nothing where another view carves, all of a side that no view sees an edge of."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.rig.design import nominal_rig
from pipeline.segmentation.ball_silhouettes import RADIUS_MM, ball_silhouettes
from pipeline.segmentation.silhouette import OUTSIDE, UNKNOWN, Silhouette
from pipeline.uncertainty.evidence import open_share
from pipeline.views.prepared import prepare_views

RIG = nominal_rig()


def without_edge(found: Silhouette) -> Silhouette:
    return replace(found, labels=np.where(found.labels == OUTSIDE, UNKNOWN, found.labels))


@pytest.mark.parametrize(("n_unknown", "least", "most"), [(0, 0.0, 0.05), (1, 0.0, 0.2), (16, 1.0, 1.0)])
def test_what_no_view_sees_an_edge_of_is_open(n_unknown: int, least: float, most: float) -> None:
    """Points of a ball where its views touch it: each is on the edge of its own view, and of some others."""
    silhouettes = ball_silhouettes(RIG)
    angles = np.linspace(0, 2 * np.pi, 60)
    circle_mm = RADIUS_MM * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    touched_mm = np.concatenate([circle_mm @ camera.R[:2] for camera in RIG.cameras])
    for camera in list(silhouettes)[:n_unknown]:
        silhouettes[camera] = without_edge(silhouettes[camera])
    assert least <= open_share(prepare_views(silhouettes, RIG), touched_mm) <= most
