"""What the interface answers, field by field; the source of the OpenAPI document.

A result is served as it was stored: fields of later versions are missing from old records and served as
null, and keys that this version does not know are served too.
"""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field
from pydantic.config import JsonDict

from service.status import AcquisitionStatus, AcquisitionTarget, CameraStatus, CheckStatus, HealthCheck, Ne107

TIME: JsonDict = {"format": "date-time"}


class Hull(BaseModel):
    """The largest body behind the silhouettes."""

    model_config = ConfigDict(extra="allow")

    volume_mm3: float
    surface_area_mm2: float
    equivalent_diameter_mm: float = Field(description="Diameter of the sphere of that volume, mm")


class ViewOptics(BaseModel):
    """How well a camera saw one exposure, against the rig when it was clean."""

    brightness: float = Field(description="Light on the wall beside the stone, 1: as in the clean rig")
    gradient_uv: list[float] = Field(
        description="The same, from the left border to the right one and from the upper to the lower one"
    )
    dust: float = Field(description="Share of the light lost in patches, 0..1")
    spots_share: float = Field(description="Share of the view darker than its surroundings, 0..1")
    saturated_share: float = Field(description="Share of all pixels that are saturated, 0..1")
    noise_grey: float = Field(description="Noise of a pixel, grey levels")
    edge_width_px: float | None = Field(
        description="Width of the outline from 10 to 90 %, px; null without one"
    )
    contrast: float | None = Field(description="Of stone and wall at the outline, share of the wall's level")


class Result(BaseModel):
    """The one outcome of one trigger. Measured fields are null unless `outcome` is `measured`."""

    model_config = ConfigDict(extra="allow")

    seq: int = Field(description="Place in the feed: strictly increasing, without gaps, never reused")
    id: str = Field(description="Unique across stores; the key for removing duplicates")
    session: int = Field(description="Run of the daemon in which the trigger came")
    bundle: str = Field(description="Name of the bundle of images")
    sequence: int = Field(description="The light gate's own count; a gap reveals lost triggers")
    kind: Literal["particle", "ball"] = Field(description="What was exposed")
    outcome: Literal["measured", "rejected", "lost"]
    reason: str | None = Field(description="Why rejected or lost, one word; null when measured")
    detail: str | None = Field(description="The reason for people")
    quality: Literal["good", "reduced", "degraded"] | None = Field(description="How well the stone was seen")
    views: list[str] = Field(description="Cameras the measurement rests on")
    dropped_views: dict[str, str] = Field(description="Cameras left out, each with the reason")
    segmenters: dict[str, str] = Field(
        description="What found the outline in each view: background, network or u2net"
    )
    segmentation_flags: dict[str, str] = Field(
        description="Cameras whose view was not left to the segmenter asked first, each with the reason"
    )
    captured_at: str = Field(description="When the stone was exposed, RFC 3339 UTC", json_schema_extra=TIME)
    recorded_at: str = Field(description="When the outcome became durable", json_schema_extra=TIME)
    body: Literal["estimate", "hull"] | None = Field(description="What mesh and shape describe")
    volume_mm3: float | None = Field(
        description="Volume, corrected by the gap between hull and estimate (without one, as a sphere's hull), mm³"
    )
    volume_raw_mm3: float | None = Field(description="Volume of the visual hull, mm³")
    volume_estimate_mm3: float | None = Field(
        description="Volume of the estimated body's mesh, mm³; null: none was asked for"
    )
    volume_model: str | None = Field(description="Id of the coefficients that `volume_mm3` rests on")
    surface_area_mm2: float | None = Field(description="Surface area of the mesh, mm²")
    length_mm: float | None = Field(description="Longest axis of the D4791 triple, mm")
    width_mm: float | None = Field(description="Middle axis of the D4791 triple, mm")
    thickness_mm: float | None = Field(description="Shortest axis of the D4791 triple, mm")
    max_feret_mm: float | None = Field(description="Greatest distance of two parallel tangent planes, mm")
    min_feret_mm: float | None = Field(description="Least distance of two parallel tangent planes, mm")
    min_box_mm: list[float] | None = Field(description="Edges of the smallest box, longest first, mm")
    sieve_size_mm: float | None = Field(description="Smallest square aperture the body passes, mm")
    equivalent_diameter_mm: float | None = Field(description="Diameter of the sphere of `volume_mm3`, mm")
    equivalent_diameter_raw_mm: float | None = Field(description="The same of `volume_raw_mm3`, mm")
    sphericity: float | None = Field(description="Area of the sphere of equal volume by surface area, 0..1")
    convexity: float | None = Field(description="Volume by volume of the convex hull, 0..1")
    elongation_ratio: float | None = Field(description="Width by length, 0..1")
    flatness_ratio: float | None = Field(description="Thickness by width, 0..1")
    zingg_class: str | None = Field(description="Form by Zingg's diagram")
    angularity: float | None = Field(description="Angularity of the surface; larger is sharper")
    mass_g: float | None = Field(description="Mass at the configured density, g; null without a density")
    center_mm: list[float] | None = Field(description="Centroid in the rig's frame (x, y, z up), mm")
    hull: Hull | None = Field(description="The visual hull, uncorrected")
    gate_extent_mm: float | None = Field(
        description="Vertical extent at the light gate, from the time its beam was closed, mm; null when unknown"
    )
    gate_extent_is_plausible: bool | None = Field(
        description="Whether the measured body can be what closed the beam; null when there is nothing to compare."
        " False: two stones in a row, a dirty beam, or a wrong measurement"
    )
    mesh: str | None = Field(description="Address of the mesh, relative to the base path; null without one")
    view_residuals_px: dict[str, float] = Field(description="Silhouette against the hull, per camera, px")
    tangency_px: dict[str, float] = Field(
        description="Epipolar residual of each camera, the median over its pairs, px; from 0.3 the camera has moved"
    )
    image_shifts_px: dict[str, list[float]] = Field(
        description="By how much (u, v) each camera sees the stone beside where the others expect it, px"
    )
    optics: dict[str, ViewOptics] = Field(description="How well each camera saw this stone")
    timings_ms: dict[str, float] = Field(description="Computing time of each stage, ms")
    calibration_id: str | None = Field(description="Calibration the measurement rests on")
    algorithm_version: str | None = Field(description="Changes whenever results may")
    is_simulated: bool | None = Field(description="True when the images are synthetic")


_EMPTY: dict[str, Any] = {
    **dict.fromkeys(Result.model_fields),
    "views": [],
    "dropped_views": {},
    "segmenters": {},
    "segmentation_flags": {},
    "view_residuals_px": {},
    "tangency_px": {},
    "image_shifts_px": {},
    "optics": {},
    "timings_ms": {},
}


def result_document(record: dict[str, Any]) -> dict[str, Any]:
    """Complete a stored record with null for what it does not know."""
    return _EMPTY | record


class ResultsPage(BaseModel):
    """A stretch of the feed. Ask again with `after = next_after`; delivery is at least once."""

    instance_id: str = Field(description="Identity of the history; when it changes, start again from 0")
    first_seq: int = Field(description="Oldest result kept; `last_seq + 1` when there is none")
    last_seq: int = Field(description="Newest result; 0 before the first")
    next_after: int
    items: list[Result]


class ParticlesPage(BaseModel):
    """Results that fit the filters, newest first."""

    items: list[Result]
    next_cursor: str | None = Field(description="Pass as `cursor` for the next page; null on the last")


class AccountingDocument(BaseModel):
    """`triggers = measured + rejected + lost + in_progress`."""

    session: int | None = Field(description="The session counted; null for all")
    triggers: int = Field(description="Stones and balls the light gate reported")
    measured: int
    rejected: int
    lost: int
    in_progress: int = Field(description="Triggers without an outcome yet")
    is_balanced: bool = Field(description="Whether the sum holds; false is a fault")
    backgrounds: int = Field(description="Exposures of the empty rig; not among the triggers")
    by_reason: dict[str, int] = Field(description="Rejected and lost, by reason")
    by_quality: dict[str, int] = Field(description="Measured, by quality")


class Acquisition(AcquisitionStatus):
    """Where the rig stands; counters are of the time since it was last armed."""


class AcquisitionRequest(BaseModel):
    """What is asked for."""

    model_config = ConfigDict(extra="forbid")

    state: AcquisitionTarget


class Camera(CameraStatus):
    """State of one camera, and its counters since the daemon started."""


class Cameras(BaseModel):
    """All cameras of the rig."""

    items: list[Camera]


class HealthDocument(BaseModel):
    """Health in detail, modelled on the expired draft health+json."""

    status: CheckStatus
    ne107: Ne107 = Field(description="Device state in the words of NAMUR NE 107")
    ready: bool = Field(description="Whether the next stone will be measured")
    reasons: list[str]
    version: str = Field(description="Version of this interface")
    instance_id: str
    checks: dict[str, HealthCheck]


class Live(BaseModel):
    """The process answers."""

    status: Literal["pass"] = "pass"


class Ready(BaseModel):
    """Stones can be accepted."""

    ready: Literal[True] = True


class FieldError(BaseModel):
    """One wrong field of a request."""

    field: str
    message: str


class ProblemDocument(BaseModel):
    """RFC 9457 problem details; further members depend on the type."""

    model_config = ConfigDict(extra="allow", title="Problem")

    type: str = Field(description="`urn:stonefall:problem:<kind>`")
    title: str
    status: int
    detail: str
    instance: str
    errors: list[FieldError] = Field(default=[], description="Of `invalid-request`: every wrong field")
