"""Limits beyond which a finding about a calibration becomes a warning or a refusal."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptanceLimits:
    """Limits: `good_...` for a warning, `min_...` and `max_...` for a refusal, the others as their check says."""

    min_views: int = 3  # of a drop: two rays always nearly meet, the third one checks
    min_drops: int = 4  # with fewer, a single outlier leaves a camera's pose undetermined
    good_drops: int = 8  # with fewer than the paper's number the held-out error is half as large again
    good_left_out_share: float = 0.2  # of the drops; single ones fall with a stone or are cut off
    min_camera_drops: int = 3  # three points determine a pose
    good_camera_drops: int = 5  # two more reveal an outlier
    min_column_mm: float = (
        2.0  # standard deviation across the column; below, errors of lengths beside it triple
    )
    good_column_mm: float = 3.0  # eight balls dropped at random within 8 mm have more in 97 of 100 cases
    swap_misfit_px: float = 10.0  # of a pattern; a camera some degrees off its pose stays below 6
    swap_ratio: float = 3.0  # of the misfits at the camera's own place and at the other
    strange_misfit_px: float = 40.0  # a camera rotated by 15 degrees about its axis
    max_apparent_edge_px: float = (
        3.0  # offset of outlines that would explain two balls' sizes; scatter is 0.7
    )
    apparent_size_percent: float = 25.0  # a lens focused near makes 9, a rough pose 1
    distance_percent: float = 0.7  # common to all cameras; the mean of 16 places known to 2 mm is 0.17 off
    focal_percent: float = 3.0  # common to all cameras, or of one from the others; workshops deviate by 1
    moved_px: float = 2.0  # 0.02 degrees, ten times the uncertainty of a good calibration
    moved_ratio: float = 6.0  # to the median camera; rigs built at random stay below 4
    step_px: float = 0.5  # shift of a camera's images between two drops
    step_significance: float = 8.0  # noise alone reaches 6 once in a thousand cameras that saw 8 drops
    good_residual_px: float = 0.3  # three times that of noise and blur in a sound rig
    max_residual_px: float = 1.0  # a camera rotated by 0.01 degrees: the hull is 0.05 mm off there
    good_length_percent: float = 0.1  # of a length in the measuring volume: 15 um of 15 mm
    max_length_percent: float = 0.5  # 1.5 percent of a volume: more than the hull's own error
    good_focus_mm: float = 5.0  # of the sharpest depth beside the middle, which F2 then spreads over 4 px
    focus_significance: float = 4.0
    good_edge_px: float = 0.6  # offset of the outlines; 0.5 is usual with a lens out of focus
    max_edge_px: float = 1.0  # no lens does that: a diameter is wrong by 0.05 mm, lengths by 0.5 percent
    max_contradicting_share: float = 0.5  # of a camera's views; single ones are dust, a stone, a screw
