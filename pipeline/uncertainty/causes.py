"""The causes of a stone's uncertainty."""

from enum import StrEnum


class Cause(StrEnum):
    """Cause that may have moved the measured surface; a word of the REST contract."""

    PIXELS = "pixels"
    """Pixels and lens at their sharpest: no edge is placed better than that."""
    FOCUS = "focus"
    """Edges wider than sharp ones, for another reason than motion or noise."""
    MOTION = "motion"
    """Edges that are wider along the fall than across it."""
    NOISE = "noise"
    """Noise of the pixels, and the smoothing against it."""
    UNSEEN = "unseen"
    """Stretches of outline that were not seen."""
    CONTRAST = "contrast"
    """Bodies so nearly as bright as the wall that patches of them look like it."""
    VIEWS = "views"
    """What the views leave between the largest and the likeliest body; or too few of them."""
    DISAGREEMENT = "disagreement"
    """Outlines that contradict each other by more than noise and calibration explain."""
    CALIBRATION = "calibration"
    """Residuals of the calibration, and the scale of its lengths."""
    HIDDEN = "hidden"
    """Dents and pores that no silhouette shows, and how well pixels show them."""
    RUSH = "rush"
    """The same dents, where there was no time for the pixels."""
