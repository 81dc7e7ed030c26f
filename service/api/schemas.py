"""What the interface answers, field by field; the source of the OpenAPI document.

A result is served as it was stored: fields of later versions are missing from old records and served as
null, and keys that this version does not know are served too.
"""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from service.results.fields import Result
from service.status import AcquisitionStatus, AcquisitionTarget, CameraStatus, CheckStatus, HealthCheck, Ne107


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
