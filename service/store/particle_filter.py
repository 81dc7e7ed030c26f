"""Filters of a list of results: each a parameter of REST and a condition in SQL."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, Field

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

    outcome: Annotated[
        Literal["measured", "rejected", "lost"] | None,
        Field(description="Only with this outcome"),
        If("outcome = ?"),
    ] = None
    quality: Annotated[
        Literal["good", "reduced", "degraded"] | None,
        Field(description="Only of this quality"),
        If("quality = ?"),
    ] = None
    kind: Annotated[
        Literal["particle", "ball"] | None, Field(description="Only of this kind"), If("kind = ?")
    ] = None
    min_sieve_size_mm: Annotated[SizeMm, If("sieve_size_mm >= ?")] = None
    max_sieve_size_mm: Annotated[SizeMm, If("sieve_size_mm <= ?")] = None
    since: Annotated[
        GivenTime | None, Field(description="Captured at or after, RFC 3339"), If("captured_at >= ?")
    ] = None
    until: Annotated[
        GivenTime | None, Field(description="Captured before, RFC 3339"), If("captured_at < ?")
    ] = None
    lot: Annotated[str | None, Field(max_length=64, description="In this lot now"), If("lot = ?")] = None
    has_frames: Annotated[
        bool | None,
        Field(
            description="True: only stones that are new enough to have their raw frames, by `[store] keep_raw`, or"
            " pinned; false: only others"
        ),
        If("(seq >= (SELECT first_raw FROM store) OR seq IN (SELECT seq FROM pins)) = ?"),
    ] = None
    zingg_class: Annotated[
        ZinggClass | None, Field(description="Only of this form"), if_stone("zingg_class = ?")
    ] = None
    is_flaky: Annotated[
        bool | None,
        Field(description="Whether it passes the slot of its fraction (EN 933-3); from 4 to 100 mm"),
        if_stone(f"{FLAKY} = ?"),
    ] = None
    is_non_cubical: Annotated[
        bool | None,
        Field(description="Whether it is longer than three times its thickness (EN 933-4); from 4 to 63 mm"),
        if_stone(f"{NON_CUBICAL} = ?"),
    ] = None
    min_volume_sd_percent: Annotated[SdPercent, if_stone("volume_sd_percent >= ?")] = None
    max_volume_sd_percent: Annotated[SdPercent, if_stone("volume_sd_percent <= ?")] = None
    quality_cause: Annotated[
        QualityCause | None,
        Field(description="Only with this among the causes of its quality"),
        if_stone("? IN (SELECT value FROM json_each(quality_causes))"),
    ] = None
    algorithm_version: Annotated[
        str | None,
        Field(max_length=16, description="Only measured by this version of the algorithm"),
        if_stone("algorithm_version = ?"),
    ] = None
    body: Annotated[
        Literal["photo", "estimate", "hull"] | None,
        Field(description="Only with this body"),
        if_stone("body = ?"),
    ] = None


def conditions_of(wanted: ParticleFilter) -> Iterator[tuple[str, str | float | None]]:
    """Yield the condition of each filter, with its value or None."""
    for name, field in ParticleFilter.model_fields.items():
        (condition,) = (each for each in field.metadata if isinstance(each, If))
        yield condition.sql, getattr(wanted, name)
