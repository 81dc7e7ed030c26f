"""Filters of a list of results: each a parameter of REST and a condition in SQL."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from pipeline.gradation.indices import EN_933_3, MAX_CUBICAL, SHAPE_RANGE_MM
from pipeline.measuring.shape import ZinggClass
from service.base.schema import GivenTime
from service.results.fields import QualityCause

_SLOTS = " ".join(
    f"WHEN sieve_size_mm > {each.low_mm} AND sieve_size_mm <= {each.high_mm} THEN {each.slot_mm}"
    for each in EN_933_3
)
FLAKY = f"(min_feret_mm <= CASE {_SLOTS} END)"
"""Whether a stone passes the slot of its own fraction; null outside of all fractions."""
NON_CUBICAL = (
    f"CASE WHEN sieve_size_mm BETWEEN {SHAPE_RANGE_MM[0]} AND {SHAPE_RANGE_MM[1]}"
    f" THEN max_feret_mm > {MAX_CUBICAL} * min_feret_mm END"
)
"""Whether a stone is longer than three times its thickness; null outside of the range of the shape index."""


@dataclass(frozen=True, slots=True)
class If:
    """SQL condition on `indexed_fields` for the value of a filter."""

    sql: str


def if_stone(condition: str) -> If:
    """Return a condition that no ball fulfils."""
    return If(f"kind = 'particle' AND {condition}")


SizeMm = Annotated[float | None, Field(ge=0, allow_inf_nan=False, description="Sieve size, mm; inclusive")]
SdPercent = Annotated[
    float | None,
    Field(ge=0, allow_inf_nan=False, description="Standard deviation of the volume, %; inclusive"),
]


class ParticleFilter(BaseModel):
    """Conditions on the results to list; None is no condition."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    outcome: Annotated[Literal["measured", "rejected", "lost"] | None, If("outcome = ?")] = None
    """Only with this outcome"""
    quality: Annotated[Literal["good", "reduced", "degraded"] | None, If("quality = ?")] = None
    """Only of this quality"""
    kind: Annotated[Literal["particle", "ball"] | None, If("kind = ?")] = None
    """Only of this kind"""
    min_sieve_size_mm: Annotated[SizeMm, If("sieve_size_mm >= ?")] = None
    max_sieve_size_mm: Annotated[SizeMm, If("sieve_size_mm <= ?")] = None
    since: Annotated[GivenTime | None, If("captured_at >= ?")] = None
    """Captured at or after, RFC 3339"""
    until: Annotated[GivenTime | None, If("captured_at < ?")] = None
    """Captured before, RFC 3339"""
    lot: Annotated[str | None, Field(max_length=64), If("lot = ?")] = None
    """In this lot now"""
    has_frames: Annotated[
        bool | None,
        Field(
            description="True: only stones that are new enough to have their raw frames, by `[store] keep_raw`, or"
            " pinned; false: only others"
        ),
        If("(seq >= (SELECT first_raw FROM store) OR seq IN (SELECT seq FROM pins)) = ?"),
    ] = None
    zingg_class: Annotated[ZinggClass | None, if_stone("zingg_class = ?")] = None
    """Only of this form"""
    is_flaky: Annotated[bool | None, if_stone(f"{FLAKY} = ?")] = None
    """Whether it passes the slot of its fraction (EN 933-3); from 4 to 100 mm"""
    is_non_cubical: Annotated[bool | None, if_stone(f"{NON_CUBICAL} = ?")] = None
    """Whether it is longer than three times its thickness (EN 933-4); from 4 to 63 mm"""
    min_volume_sd_percent: Annotated[SdPercent, if_stone("volume_sd_percent >= ?")] = None
    max_volume_sd_percent: Annotated[SdPercent, if_stone("volume_sd_percent <= ?")] = None
    quality_cause: Annotated[
        QualityCause | None, if_stone("? IN (SELECT value FROM json_each(quality_causes))")
    ] = None
    """Only with this among the causes of its quality"""
    algorithm_version: Annotated[str | None, Field(max_length=16), if_stone("algorithm_version = ?")] = None
    """Only measured by this version of the algorithm"""
    body: Annotated[Literal["photo", "estimate", "hull"] | None, if_stone("body = ?")] = None
    """Only with this body"""


def conditions_of(wanted: ParticleFilter) -> Iterator[tuple[str, str | float | None]]:
    """Yield the condition of each filter, with its value or None."""
    for name, field in ParticleFilter.model_fields.items():
        (condition,) = (each for each in field.metadata if isinstance(each, If))
        yield condition.sql, getattr(wanted, name)
