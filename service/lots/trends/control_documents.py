"""Control charts of a product as REST returns them, and the limits that a plant sets."""

from collections.abc import Mapping
from dataclasses import field
from enum import StrEnum
from typing import Annotated

from pydantic import Field

from pipeline.gradation.capability import Capability
from pipeline.gradation.control_chart import RuleName
from pipeline.gradation.estimates import Estimate
from pipeline.gradation.specification import Range
from service.base.schema import GivenTime, Time, request_body
from service.base.status import Report
from service.lots.trends.diary import DiaryEntry
from service.store.events import NewEvent


@request_body
class ControlLimits:
    """What a figure is to be, in the unit of its name."""

    centre: Annotated[float, Field(ge=0, le=1000)]
    """Target of the figure: the centre line."""
    sd: Annotated[float, Field(ge=0, le=1000)]
    """Standard deviation from lot to lot, without errors of sampling: those of each lot are added."""


@request_body
class ControlSettings:
    """Limits of a product's charts; those of figures that are not named come from its first lots."""

    since: GivenTime | None = None
    """Lots that were closed before, RFC 3339, are left out: after a deliberate change the first ones from then on make
    new limits."""
    limits: Annotated[Mapping[str, ControlLimits], Field(max_length=20)] = field(default_factory=dict)
    """By figure, such as `d50_mm` or `passing_16_mm_percent`."""


class Origin(StrEnum):
    """Where limits come from."""

    BY_HAND = "by_hand"
    FIRST_LOTS = "first_lots"


class Causes(Report):
    """What was done to the crusher, and what happened to the rig, since the last lot before the pattern began."""

    since: Time = Field(description="That lot was closed, or the first one opened, RFC 3339 UTC")
    until: Time = Field(description="The lot of this point was closed")
    diary: list[DiaryEntry] = Field(description="Entries of the crusher's diary, newest first")
    events: list[NewEvent] = Field(
        description="Alarms of the rig and calibrations, newest first, as far as events are kept"
    )


class ControlPoint(Report):
    """One lot of a chart."""

    lot: str = Field(description="Id of the lot")
    closed_at: Time = Field(description="When it was closed, RFC 3339 UTC")
    figure: Estimate = Field(description="The figure that it was completed with, in the unit of its name")
    is_counted: bool = Field(
        description="False: too few stones; it is shown, and in neither limits nor rules"
    )
    lower: float | None = Field(
        description="Lower limit, three standard deviations of a lot of so many stones; null: none yet"
    )
    upper: float | None = Field(description="Upper limit")
    ewma: float | None = Field(
        description="Weighted mean of all lots until this one, weight 0.1 (EWMA); null: no limits yet"
    )
    ewma_lower: float | None = Field(description="Lower limit of it, 2.7 standard deviations")
    ewma_upper: float | None = Field(description="Upper limit of it")
    rules: list[RuleName] = Field(description="Rules that this lot violates; empty: in control")
    causes: Causes | None = Field(description="Candidates for the cause; null: in control")


class FigureControl(Report):
    """Control chart of one figure of a product, ISO 7870-2 and ISO 7870-6."""

    figure: str = Field(description="Name with unit, such as `d50_mm` or `passing_16_mm_percent`")
    origin: Origin | None = Field(
        description="Limits were set by hand, or are of the first 20 lots that count, 8 at least; null: none yet"
    )
    n_baseline: int = Field(description="Lots that the limits rest on; 0: none, or set by hand")
    centre: float | None = Field(description="Centre line; null: no limits yet")
    sd: float | None = Field(description="Standard deviation from lot to lot, without errors of sampling")
    specified: Range | None = Field(description="Limits of the product's specification; null: none")
    capability: Capability | None = Field(
        description="Against these; null: no limits, fewer than 20 lots that count, or all alike"
    )
    points: list[ControlPoint] = Field(description="The newest lots, oldest first")


class DriftedFigure(Report):
    """A figure that is out of control."""

    figure: str = Field(description="Name with unit")
    value: float = Field(description="Of the newest lot that counts")
    centre: float = Field(description="Centre line")
    rules: list[RuleName] = Field(description="Rules that it violates")


class ProductControl(Report):
    """Control charts of a product: D50, passing at the sieves of d and D, flakiness and shape index."""

    product: str = Field(description="Id of the product")
    settings: ControlSettings = Field(description="As they were set; empty: limits of the first lots")
    drifting: list[DriftedFigure] = Field(
        description="Figures whose newest lot that counts is beyond its limits, or whose EWMA is; none before 20 lots"
    )
    charts: list[FigureControl] = Field(
        description="Each figure; without points before the first completed lot"
    )


class ProductDrift(Report):
    """The figures of a product that drift."""

    product: str = Field(description="Id of the product")
    figures: list[DriftedFigure] = Field(description="Each figure that drifts")
