"""The fields of a result, each defined once: name, type, unit, definition, and value when unknown.

The records in `results.jsonl` and in the store, the schema of the REST interface, the tables of the commands and the
list in `service/web/README.md` follow from `Result`. A measured field has the name of the attribute of
`pipeline.particle.ParticleMeasurement` or `pipeline.measuring.ShapeMeasurement` that it is read from. A field
that has no description here has that of `ShapeMeasurement`.
"""

from collections.abc import Mapping, Sequence
from enum import StrEnum
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from pipeline.measuring.shape import ShapeMeasurement
from pipeline.view_optics import ViewOptics
from service.base.schema import Time, always_present

ONLY_IF_MEASURED = "null unless measured"
"""Marks a field that is null unless the outcome is `measured`."""
INDEXED = "indexed"
"""Marks a field that results are searched, listed or counted by: a column of `service.store.indexed_fields`."""
STORED = "stored"
"""Marks a field that a result gets when it becomes durable."""
LEAN = "lean"
"""Marks a field of the choice `fields=lean`."""
T = TypeVar("T")
Indexed = Annotated[T, INDEXED]
Stored = Annotated[T, STORED]
Lean = Annotated[T, LEAN]

ALWAYS = ("seq", "id", "revision", "kind", "outcome", "is_simulated", "is_replay")
"""Fields that are in every answer, whichever are chosen: what is not production must never be billed as such."""

SHAPE_SCHEMA = TypeAdapter(ShapeMeasurement).json_schema()["properties"]
"""The measures of the shape by name, as JSON schemas with their descriptions."""


def chosen_present(schema: dict[str, Any]) -> None:
    """Mark as required what is in every choice of fields; without `fields` all are there, defaults included.

    Measures of the shape are described in `ShapeMeasurement`, unless a field here says more.
    """
    always_present(schema)
    schema["required"] = list(ALWAYS)
    for name, measure in SHAPE_SCHEMA.items():
        schema["properties"][name].setdefault("description", measure["description"])


class Outcome(StrEnum):
    """What became of a trigger; a word of the REST contract."""

    MEASURED = "measured"
    """The stone has a body and its measures."""
    REJECTED = "rejected"
    """The views were looked at and found unfit, for a `pipeline.errors.RejectReason`."""
    LOST = "lost"
    """The views were never looked at, for a `LossReason`."""


class LossReason(StrEnum):
    """Why a trigger ends as `lost`; a word of the REST contract."""

    QUEUE_FULL = "queue_full"
    """As many bundles were waiting as the spool takes, or its file system was full."""
    STORE_HELD = "store_held"
    """Nothing could be written to the store for so long that no more bundles could wait."""
    NO_FRAMES = "no_frames"
    """No camera delivered a frame; `detail` has the reasons why each is missing."""
    WORKER_CRASH = "worker_crash"
    """Two worker processes, one after the other, died or failed over the bundle."""
    DEADLINE = "deadline"
    """Two worker processes, one after the other, were not finished with the bundle within `workers.deadline_s`."""
    UNREADABLE = "unreadable"
    """The bundle's file is damaged."""
    CRASH = "crash"
    """The daemon ended before the bundle was measured, and it is not in the spool; recorded by its next start."""
    DOWN = "down"
    """The light gate counted it after the daemon had been killed and before the next one was armed."""
    SHUTDOWN = "shutdown"
    """The daemon was stopped before the bundle was measured, or the rig disarmed before its frames came."""


RUSH = "other stones were waiting"
"""The record's `refinement_fallback` of a stone that was not refined for want of time."""


class NotRefined(StrEnum):
    """Why a stone stays as estimated although `[body] kind` is `photo`; a word of the REST contract."""

    RUSH = "rush"
    """Other stones were waiting; it can be measured again."""
    NO_EVIDENCE = "no_evidence"
    """The pixels were looked at and showed nothing that could be used."""


def why_not_refined(fallback: str) -> NotRefined:
    """Classify a record's `refinement_fallback`."""
    return NotRefined.RUSH if fallback == RUSH else NotRefined.NO_EVIDENCE


class DensitySource(StrEnum):
    """Where the density comes from that a stone's mass is by."""

    PRODUCT = "product"
    CONFIGURATION = "configuration"


class Hull(BaseModel):
    """The visual hull: the largest body consistent with the silhouettes."""

    model_config = ConfigDict(extra="allow")

    volume_mm3: float = Field(description="Volume of the visual hull, mm³")
    surface_area_mm2: float = Field(description="Surface area of the visual hull, mm²")
    equivalent_diameter_mm: float = Field(description="Diameter of the sphere of that volume, mm")


Number = Annotated[float | None, ONLY_IF_MEASURED]
Numbers = Annotated[list[float] | None, ONLY_IF_MEASURED]
Text = Annotated[str | None, ONLY_IF_MEASURED]


class Verified(StrEnum):
    """Whether balls of known diameter show that the calibration in use is right."""

    PASSED = "passed"
    FAILED = "failed"
    OVERDUE = "overdue"
    """The last time is longer ago than `[verification] every_h`."""
    NEVER = "never"


QualityCause = Literal[
    "pixels",
    "focus",
    "motion",
    "noise",
    "unseen",
    "contrast",
    "views",
    "disagreement",
    "calibration",
    "hidden",
    "rush",
]
"""Why a result may be further from the truth than `good` ones."""


class Result(BaseModel):
    """The one outcome of one trigger, or a revision of it. Measured fields are null unless `outcome` is `measured`.

    All fields are there, unless the request chose some with `fields`.
    """

    model_config = ConfigDict(extra="allow", json_schema_extra=chosen_present, use_attribute_docstrings=True)

    seq: Stored[int]
    """Place in the feed: strictly increasing, without gaps, never reused"""
    id: Stored[str]
    """Of the stone, unique across stores: the key to store it by. Its revisions have the same"""
    revision: Stored[int] = 1
    """1: the first result of the stone; higher: it was measured again, and this takes the place of what was
    said of it before"""
    revises: Stored[Lean[int | None]] = None
    """`seq` of the item that this one takes the place of; null for the first"""
    session: Stored[int]
    """Run of the daemon in which the trigger came"""
    bundle: str
    """Name of the bundle of images"""
    sequence: int
    """The light gate's own count; a gap reveals lost triggers"""
    kind: Indexed[Literal["particle", "ball"]]
    """What was exposed"""
    n_stones: Lean[int] = 1
    """Stones that this outcome is of: 1, but for a loss of many together, of which only the light gate's
    counter knows: add them up"""
    captured_at: Lean[Indexed[Time]]
    """When the stone was exposed, RFC 3339 UTC"""
    recorded_at: Stored[Lean[Time]]
    """When the outcome became durable"""
    time_is_doubtful: Stored[Lean[bool | None]] = None
    """True when the host's clock was not set: `captured_at` or `recorded_at` is before 2026"""
    outcome: Indexed[Literal[Outcome.MEASURED, Outcome.REJECTED, Outcome.LOST]]
    """`measured`: the stone has a body and its measures; `rejected`: the views were looked at and found unfit;
    `lost`: they were never looked at"""
    reason: Lean[Indexed[str | None]] = None
    """Why rejected or lost, one word; null when measured"""
    detail: str | None = None
    """The reason for people"""
    quality: Lean[Indexed[Literal["good", "reduced", "degraded"] | None]] = None
    """How far from the truth the result may be, by `[quality]` and by the number of views"""
    quality_causes: Indexed[list[QualityCause]] = []
    """Why the quality is not `good`, the greatest cause first"""
    views: list[str] = []
    """Cameras whose views were measured"""
    dropped_views: dict[str, str] = {}
    """Cameras whose views were not used, each with the reason"""
    segmenters: dict[str, str] = {}
    """Segmenter that found the outline in each view: background, network, u2net; mask: the image was one"""
    segmentation_flags: dict[str, str] = {}
    """Cameras whose view another segmenter than the first decided, each with the reason"""
    body: Indexed[Annotated[Literal["photo", "estimate", "hull"] | None, ONLY_IF_MEASURED]] = None
    """Body that mesh and shape describe: the estimate refined by the pixels inside the outlines, the estimate,
    or the visual hull"""
    supported_share: Number = None
    """Share of the surface, 0 to 1, that those pixels say something about; null when they were not examined"""
    refinement_fallback: Indexed[Text] = None
    """Why the estimate was not refined although `[body] kind` is `photo`; null when it was, or need not be"""
    volume_mm3: Lean[Indexed[Number]] = None
    """Volume, corrected by the gap between hull and estimate (without one, as a sphere's hull, or not at all:
    see `volume_model`), mm³"""
    volume_sd_percent: Lean[Indexed[Number]] = None
    """Standard deviation of `volume_mm3`, %, dents that no silhouette shows included"""
    surface_sd_mm: Lean[Indexed[Number]] = None
    """Standard deviation of the mesh's distance to the stone's surface, mm"""
    volume_raw_mm3: Number = None
    """Volume of the visual hull, mm³"""
    volume_estimate_mm3: Number = None
    """Volume of the estimated body's mesh, mm³; null when nothing is estimated"""
    volume_model: Text = None
    """Id of the coefficients that `volume_mm3` is corrected with; `sphere`: as a sphere's hull; `none`: it is
    not"""
    surface_area_mm2: Number = None
    length_mm: Lean[Indexed[Number]] = None
    width_mm: Lean[Indexed[Number]] = None
    thickness_mm: Lean[Indexed[Number]] = None
    max_feret_mm: Lean[Indexed[Number]] = None
    min_feret_mm: Lean[Indexed[Number]] = None
    min_box_mm: Numbers = None
    sieve_size_mm: Lean[Indexed[Number]] = None
    equivalent_diameter_mm: Lean[Number] = None
    """Diameter of the sphere of `volume_mm3`: (6 V / pi)^(1/3), mm"""
    equivalent_diameter_raw_mm: Number = None
    """Diameter of the sphere of `volume_raw_mm3`, mm"""
    sphericity: Indexed[Number] = None
    convexity: Indexed[Number] = None
    elongation_ratio: Indexed[Number] = None
    flatness_ratio: Indexed[Number] = None
    zingg_class: Indexed[Text] = None
    krumbein: Number = None
    corey: Number = None
    angularity: Indexed[Number] = None
    """Gradient angularity after AASHTO T 381, with squares: the sum over 180 points of an outline of the
    squared change of its direction, degrees², / 59; mean over the views, 0..10000. A circle has 110, a square
    1115. Not comparable with values of an AIMS device"""
    mass_g: Lean[Number] = None
    """Mass by `volume_mm3` and `density_kg_m3`, g; null without a density"""
    density_kg_m3: Number = None
    """Density of the particles (EN 1097-6) that the mass is by, kg/m³"""
    density_source: DensitySource | None = None
    """`product`: of the stone's lot; `configuration`: it was in no lot; null without a density. A stone that is put
    into a lot after it was measured has its product's with the next revision"""
    center_mm: Numbers = None
    """Centroid in the rig's frame (x, y, z up), mm"""
    hull: Annotated[Hull | None, ONLY_IF_MEASURED] = None
    """The visual hull, uncorrected"""
    gate_extent_mm: float | None = None
    """Vertical extent at the light gate, from the time its beam was closed, mm; null when unknown"""
    gate_extent_is_plausible: bool | None = None
    """Whether the measured body fits the time the beam was closed; null when there is nothing to compare.
    False: two stones in a row, a dirty beam, or a wrong measurement"""
    mesh: str | None = None
    """Address of the mesh, relative to the base path; null without one"""
    view_residuals_px: dict[str, float] = {}
    """By how much each outline leaves the hull of the other views, rms, px"""
    tangency_px: dict[str, float] = {}
    """Epipolar residual of each camera, the median over its pairs, px; from 0.3 the camera has moved"""
    image_shifts_px: dict[str, list[float]] = {}
    """Shift (u, v) of the stone in each camera's image from where the other views expect it, px"""
    optics: dict[str, ViewOptics] = {}
    """How well each camera saw this stone"""
    timings_ms: dict[str, float] = {}
    """Computing time of each stage, ms"""
    calibration_id: Lean[Indexed[str | None]] = None
    """Calibration that was measured with"""
    verification: Stored[Lean[Verified | None]] = None
    """What the last balls said of the rig when the stone was measured"""
    algorithm_version: Indexed[str | None] = None
    """Changes whenever results may"""
    is_simulated: Indexed[bool | None] = None
    """True when the images are synthetic"""
    is_replay: Stored[Indexed[bool | None]] = None
    """True when no stone fell: a recording was played, or the rig is simulated"""
    lot: Stored[Lean[str | None]] = None
    """Lot that the stone is in now: it may be assigned later; null outside of any"""
    files_removed: Stored[Literal["age", "space"] | None] = None
    """Why mesh, silhouettes and images were removed by `[store.retention]`; null when they were not"""
    is_pinned: Stored[bool] = False
    """True when result and files are kept whatever their age"""
    pin_reason: Stored[str | None] = None
    """Why it is pinned; null when it is not"""


def _marked(mark: str) -> tuple[str, ...]:
    return tuple(name for name, field in Result.model_fields.items() if mark in field.metadata)


MEASURED_FIELDS = _marked(ONLY_IF_MEASURED)
"""Fields that are null unless the outcome is `measured`."""

INDEXED_FIELDS = _marked(INDEXED)
"""Fields that results are searched, listed or counted by."""

STORED_FIELDS = _marked(STORED)
"""Fields that a result gets when it becomes durable; `results.jsonl` lacks them."""

LEAN_FIELDS = frozenset({*ALWAYS, *_marked(LEAN)})
"""What a MES needs of a stone: identity, outcome, sizes, mass and how far to trust them."""

EMPTY: Mapping[str, Any] = {
    name: None if field.is_required() else field.default for name, field in Result.model_fields.items()
}
"""A record in which nothing is known: every field with its default."""


def completed(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record with the fields added that the version which stored it did not have."""
    return {**EMPTY, **record}


class UnknownFieldsError(ValueError):
    """Fields were asked for that no result has."""

    def __init__(self, names: Sequence[str]) -> None:
        known = ", ".join(Result.model_fields)
        super().__init__(f"no result has {', '.join(map(repr, names))}; there are `{LEAN}`, {known}")


def chosen_fields(text: str) -> tuple[str, ...]:
    """Return the fields that a list like `lean,optics` names, in the order of a result; some are in every choice.

    An `UnknownFieldsError` names those that there are not.
    """
    names = {name.strip() for name in text.split(",")} - {""}
    if unknown := sorted(names - {LEAN, *Result.model_fields}):
        raise UnknownFieldsError(unknown)
    wanted = names.union(ALWAYS, LEAN_FIELDS if LEAN in names else ())
    return tuple(name for name in Result.model_fields if name in wanted)


def served(record: Mapping[str, Any], names: Sequence[str] | None) -> dict[str, Any]:
    """Return a record as it is served: with all fields, or with these alone."""
    whole = completed(record)
    return whole if names is None else {name: whole[name] for name in names}
