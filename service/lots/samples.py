"""Repeated runs of one sample: repeatability and reproducibility of their figures (ISO 5725-2)."""

import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from http import HTTPStatus

from pipeline.gradation.repeatability import Repeatability, repeatability
from service.base.errors import ProblemError, ProblemKind
from service.base.schema import ANSWER
from service.lots.evaluation import figures_of
from service.lots.figures import named_figures
from service.lots.lots import LotDocument, LotState, lots_of_sample
from service.lots.products import find_product
from service.lots.stones import stones_of_lot
from service.lots.yardsticks import Request


class RunsTooFewError(ProblemError):
    """No two runs of the sample were made under equal conditions."""

    kinds = (ProblemKind("too-few-runs", HTTPStatus.CONFLICT, "The sample has too few runs to compare"),)


class Conditions(StrEnum):
    """Conditions that runs of one group have in common."""

    DAY = "day"
    """Opened on one day, UTC."""
    SAMPLER = "sampler"
    EQUIPMENT = "equipment"


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A lot that is a run of the sample."""

    __pydantic_config__ = ANSWER

    lot: str
    """Id of the lot."""
    group: str
    """Runs of equal conditions have the same."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleStudy:
    """Repeatability and reproducibility from repeated runs of one sample (ISO 5725-2)."""

    __pydantic_config__ = ANSWER

    sample_id: str
    """Id of the laboratory sample."""
    product: str
    """Product of the newest run; all runs are judged by it."""
    product_version: int
    """Version of the product."""
    runs: list[Run]
    """Oldest first."""
    figures: Mapping[str, Repeatability]
    """By name, in the unit at its end; figures that every run has."""


def sample_study(
    connection: sqlite3.Connection, sample_id: str, conditions: Conditions, request: Request
) -> SampleStudy | None:
    """Compare the closed lots with this sample id, all by the product of the newest; None if there is none.

    Raises `RunsTooFewError` if no two runs were made under equal conditions, and as `yardstick_of` does.
    """
    records = [each for each in lots_of_sample(connection, sample_id) if each.state is LotState.CLOSED]
    if not records:
        return None
    newest = records[-1]
    product = find_product(connection, newest.product, newest.product_version)
    runs = [Run(lot=each.lot, group=_group(each, conditions)) for each in records]
    figures_of_runs = [
        named_figures(figures_of(stones_of_lot(connection, run.lot), request, product)) for run in runs
    ]
    found = [
        {name: each.value for name, each in named.items() if each.value is not None}
        for named in figures_of_runs
    ]
    names = [name for name in found[-1] if all(name in values for values in found)]
    groups = {run.group: [each for each in range(len(runs)) if runs[each].group == run.group] for run in runs}
    try:
        figures = {
            name: repeatability([[found[each][name] for each in members] for members in groups.values()])
            for name in names
        }
    except ValueError as err:
        raise RunsTooFewError(f"sample {sample_id}: {err}: a group has the same {conditions}") from err
    return SampleStudy(
        sample_id=sample_id,
        product=newest.product,
        product_version=newest.product_version,
        runs=runs,
        figures=figures,
    )


def _group(record: LotDocument, conditions: Conditions) -> str:
    if conditions is Conditions.DAY:
        return record.opened_at[:10]
    said = record.sampler if conditions is Conditions.SAMPLER else record.equipment
    return said or f"unknown, {record.lot}"  # may equal no other
