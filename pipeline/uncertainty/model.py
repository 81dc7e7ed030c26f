"""The uncertainty of one stone: independent causes, each with the distance by which it moves the surface, one sigma.

The squares of these distances add up. Every coefficient is a statement about silhouettes, not a fit to images.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np
from scipy.special import ndtr

from pipeline.segmentation.delineation import MIN_CONTRAST
from pipeline.segmentation.noise import MAX_SMOOTHING_PX, QUIET_GREY, SMOOTHING_PX_PER_GREY
from pipeline.uncertainty.causes import Cause
from pipeline.uncertainty.evidence import WALL_GREY, Evidence, ViewEvidence

SHARP_SIGMA_PX = 1.0
"""Blur of an edge by lens and pixels alone."""
SHARE_OF_SIGMA = 0.15
"""Share of its blur's sigma by which an edge is misplaced. The half-level of a blurred right-angled corner recedes from
its sides by 0.27 sigma on average up to two sigmas away, an edge that is straight by none: outlines are about half of
each."""
NOISE_FACTOR = 1.33
"""Error of an edge's place, in px, for each unit of noise over step: the Cramér-Rao bound of a Gaussian edge,
sqrt(2 sqrt(pi) sigma / length), with a length of two sigmas along the edge."""
TANGENCY_PER_PX = 1.18
"""Median tangency residual of outlines that are independently off by 1 px: sqrt(2) px for each of a pair's two planes,
of which the rms has this median."""
GAP_SHARE = 0.1
"""Share of the mean distance of hull and estimate by which the estimate is off: the correction of the volume adds
0.11 of the gap to it on average, with the opposite sign for round bodies."""
HULL_EXCESS = 4.0
"""Excess of the hulls of stones relative to that of a sphere's, which is all that a hull is corrected by."""
UNSEEN_RISE, CAP_RISE = 0.15, 2.0
"""Distance, as a share of the mean radius, by which a patch that no view outlines is off at most: a sphere rises by
0.13 over a chord of 60 degrees; and for each share of the surface that it covers, as a sphere's cap rises."""
ANYWHERE = 1 / sqrt(3)
"""Standard deviation of a body's border that is anywhere between where it is drawn and so far below, for each unit of
that distance."""
TEXTURE_SHARE = 0.15
"""Standard deviation of a stone's texture, as a share of the wall's level."""
HIDDEN_PERCENT = 2.5
"""Volume of the dents and pores that no silhouette shows; one sigma, since they differ from stone to stone: 0 to 4 % of
our bodies, up to 6 % of scanned stones. Dents lie here and there: their variance grows with the surface that may have
them."""
DENT_FACTOR, DENTS_SHARE = 1.5, 0.05
"""Depth of those dents, rms over the surface that may have them, for each of their mean depth; and share of the surface
that says as much of dents, where pixels show it, as other stones do."""
REFINED_MM, MISSED_RELIEF = 0.01, 1.4
"""Standard deviation of the surface where pixels inside the outlines show how deep it lies, a quarter of a pixel; and
depth of what they miss there, for each millimetre of the finest relief that they show."""
COMMON_SHARE, REFINED_COMMON_SHARE = 0.5, 0.2
"""Share of a surface's error that has the same sign all around, and so changes the volume: of an outline's, which holds
for a whole view, and of what pixels show, patch by patch."""
ALL_COMMON = (Cause.CONTRAST, Cause.CALIBRATION)
"""Causes whose whole error has the same sign all around: what looks like the wall is carved; a wrong scale. So have
dents, but not what is left where pixels show them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncertainty:
    """The uncertainty of one stone, one sigma: distance of its surface, and volume."""

    surface_mm: Mapping[Cause, float]  # by each cause alone
    volume_percent: Mapping[Cause, float]

    @property
    def surface_sd_mm(self) -> float:
        """Standard deviation of the surface, all causes together."""
        return hypot(*self.surface_mm.values())

    @property
    def volume_sd_percent(self) -> float:
        """Standard deviation of the volume, all causes together."""
        return hypot(*self.volume_percent.values())

    @property
    def by_cause(self) -> dict[Cause, float]:
        """Share of each cause in the variance of the surface; together 1."""
        total = sum(sd_mm**2 for sd_mm in self.surface_mm.values())
        return {cause: sd_mm**2 / total for cause, sd_mm in self.surface_mm.items()}


def uncertainty(evidence: Evidence) -> Uncertainty:
    """Return the uncertainty that follows from what is known of a stone's views."""
    volume_mm3, area_mm2 = evidence.volume_mm3, evidence.area_mm2
    radius_mm = 3 * volume_mm3 / area_mm2  # of a sphere with this ratio
    scale_mm = evidence.length_sd_percent / 100 * radius_mm
    pixels, dents_mm = evidence.pixels, _dents_mm(evidence)
    hidden_share = 1 - pixels.share
    unseen_mm, unseen_mean_mm = _unseen_mm(evidence, radius_mm)
    refined_mm = sqrt(pixels.share) * hypot(REFINED_MM, MISSED_RELIEF * pixels.relief_mm)
    surface_mm = {
        Cause.PIXELS: _rms_mm(evidence, lambda view: SHARE_OF_SIGMA * SHARP_SIGMA_PX),
        Cause.FOCUS: _rms_mm(evidence, lambda view: SHARE_OF_SIGMA * _defocus_px(view)),
        Cause.MOTION: _rms_mm(evidence, lambda view: SHARE_OF_SIGMA * view.motion_sigma_px),
        Cause.NOISE: _rms_mm(
            evidence, lambda view: hypot(SHARE_OF_SIGMA * _smoothing_px(view), _noise_px(view))
        ),
        Cause.UNSEEN: unseen_mm,
        Cause.CONTRAST: UNSEEN_RISE
        * radius_mm
        * float(np.mean([_share_like_wall(view.step_grey) for view in evidence.views]))
        * hidden_share,
        Cause.VIEWS: (GAP_SHARE if evidence.is_estimated else HULL_EXCESS)
        * max(evidence.hull_mm3 - volume_mm3, 0.0)
        / area_mm2
        * hidden_share,
        Cause.DISAGREEMENT: _disagreement_mm(evidence),
        Cause.CALIBRATION: hypot(scale_mm, _rms_mm(evidence, lambda view: view.calibration_px)),
        Cause.HIDDEN: hypot(sqrt(pixels.blank_share) * dents_mm, refined_mm),
    }
    percent_per_mm = 100 * area_mm2 / volume_mm3
    # views disagree each in its own way
    common = dict.fromkeys(ALL_COMMON, 1.0) | {Cause.DISAGREEMENT: 1 / sqrt(len(evidence.views))}
    volume_percent = {
        cause: percent_per_mm * sd_mm * common.get(cause, COMMON_SHARE) for cause, sd_mm in surface_mm.items()
    }
    volume_percent[Cause.UNSEEN] = ANYWHERE * percent_per_mm * unseen_mean_mm
    volume_percent[Cause.HIDDEN] = percent_per_mm * hypot(
        pixels.blank_share * dents_mm / DENT_FACTOR, REFINED_COMMON_SHARE * refined_mm
    )
    return Uncertainty(surface_mm=surface_mm, volume_percent=volume_percent)


def _dents_mm(evidence: Evidence) -> float:
    """Return the rms depth of dents where pixels show none: as where they do, as far as these show enough."""
    usual_mm = DENT_FACTOR * HIDDEN_PERCENT / 100 * evidence.volume_mm3 / evidence.area_mm2
    known = evidence.pixels.share / (evidence.pixels.share + DENTS_SHARE)
    return sqrt(known * evidence.pixels.depth_mm**2 + (1 - known) * usual_mm**2)


def _rms_mm(evidence: Evidence, of_view_px: Callable[[ViewEvidence], float]) -> float:
    """Return the rms over the views of a length in pixels, in mm at the stone."""
    return float(np.sqrt(np.mean([(view.pixel_mm * of_view_px(view)) ** 2 for view in evidence.views])))


def _smoothing_px(view: ViewEvidence) -> float:
    """Return the sigma by which the view was smoothed."""
    if view.noise_grey <= QUIET_GREY:
        return 0.0
    return min(SMOOTHING_PX_PER_GREY * view.noise_grey, MAX_SMOOTHING_PX)


def _noise_px(view: ViewEvidence) -> float:
    return NOISE_FACTOR * view.noise_grey / view.step_grey


def _defocus_px(view: ViewEvidence) -> float:
    """Return the sigma of an edge beyond that of a sharp one, of motion and of smoothing."""
    others_px = hypot(SHARP_SIGMA_PX, view.motion_sigma_px, _smoothing_px(view))
    return sqrt(max(view.edge_sigma_px**2 - others_px**2, 0.0))


def _unseen_mm(evidence: Evidence, radius_mm: float) -> tuple[float, float]:
    """Return by how much patches that no view outlines are off, and openings that only undecided views look through.

    As rms over the surface, and as mean: all of it has one sign. Where pixels show the surface, both are known. An
    opening is filled where the views through it leave it unknown: a share of the volume as great as that of their area
    is at stake in each of them, but no more than is open.
    """
    is_open = evidence.open_share * (1 - evidence.pixels.share)
    undecided = float(np.sqrt(np.mean([view.undecided_share**2 for view in evidence.views])))
    filled_mm = min(undecided, is_open) * evidence.volume_mm3 / evidence.area_mm2
    rise_mm = min(UNSEEN_RISE, CAP_RISE * is_open) * radius_mm
    return hypot(sqrt(is_open) * rise_mm, filled_mm), hypot(is_open * rise_mm, filled_mm)


def _share_like_wall(step_grey: float) -> float:
    """Return the share of a body's surface on which its texture leaves less contrast to the wall than an edge needs."""
    return float(ndtr((MIN_CONTRAST - step_grey / WALL_GREY) / TEXTURE_SHARE))


def _disagreement_mm(evidence: Evidence) -> float:
    """Return by how much the outlines are off, by the tangents that they share and the hulls that they leave.

    What noise and calibration explain of it is theirs.
    """
    pixel_mm = float(np.mean([view.pixel_mm for view in evidence.views]))
    expected_mm = hypot(_rms_mm(evidence, _noise_px), _rms_mm(evidence, lambda view: view.calibration_px))
    known_px = [view.tangency_px for view in evidence.views if view.tangency_px is not None]
    tangency_mm = pixel_mm * float(np.median(known_px)) / TANGENCY_PER_PX if known_px else 0.0
    residual_mm = _rms_mm(evidence, lambda view: view.residual_px)
    return sqrt(max(tangency_mm**2 + residual_mm**2 - expected_mm**2, 0.0))
