"""How well a camera saw one exposure."""

from dataclasses import dataclass

from pipeline.schema import SCHEMA


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewOptics:
    """How well a camera saw one exposure, compared with the clean rig."""

    __pydantic_config__ = SCHEMA

    brightness: float
    """Light on the wall beside the stone, 1: as in the clean rig"""
    gradient_uv: tuple[float, ...]
    """Change of the brightness from the left border to the right and from the upper to the lower one"""
    dust: float
    """Share of the light lost in patches, 0..1"""
    spots_share: float
    """Share of the view darker than its surroundings, 0..1"""
    saturated_share: float
    """Share of all pixels that are saturated, 0..1"""
    noise_grey: float
    """Noise of a pixel, grey levels"""
    edge_width_px: float | None
    """Width of the outline from 10 to 90 %, px; null without one"""
    edge_widths_uv_px: tuple[float, ...] | None
    """The same of blurred edges across u, and of those across v; null for a sharp outline"""
    contrast: float | None
    """Contrast of stone and wall at the outline, share of the wall's level"""
