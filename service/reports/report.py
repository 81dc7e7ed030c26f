"""Data of a lot's report: its figures, and the rest that a person signs for."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from service.base.language import Language
from service.base.schema import Time, served
from service.lots.figures import LotFigures
from service.lots.laboratory import StoredSieving
from service.lots.plant import PlantSettings

Scalar = str | int | float | bool | None
"""What a cell of a table holds."""


class ReportFormat(StrEnum):
    """File format of a report, and the suffix of its file."""

    HTML = "html"
    PDF = "pdf"
    CSV = "csv"
    XLSX = "xlsx"


MEDIA_TYPES = {
    ReportFormat.HTML: "text/html; charset=utf-8",
    ReportFormat.PDF: "application/pdf",
    ReportFormat.CSV: "text/csv; charset=utf-8; header=present",
    ReportFormat.XLSX: "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
}
"""Types that answers of REST name."""


class VerificationOutcome(StrEnum):
    """Result of the last verification with a sphere."""

    PASSED = "passed"
    FAILED = "failed"


@served
class EndedVerification:
    """A verification with a ball that has its verdict."""

    id: str
    """Id of the verification."""
    at: Time
    """When it ended, RFC 3339 UTC."""
    outcome: VerificationOutcome
    """Its verdict."""
    diameter_mm: float
    """Diameter of the ball, mm."""
    error_mm: float | None
    """Mean diameter measured less the ball's, mm; null if no ball was measured."""


class GalleryReason(StrEnum):
    """Why a stone is shown."""

    HEAVIEST = "heaviest"
    """The curve depends most on it."""
    NEAREST_LIMIT = "nearest_limit"
    """Its size is nearest to an aperture that has limits."""
    LARGEST = "largest"
    MOST_ELONGATED = "most_elongated"


@dataclass(frozen=True, slots=True, kw_only=True)
class GalleryStone:
    """A stone that matters for the figures."""

    id: str
    reasons: Sequence[GalleryReason]
    sieve_size_mm: float
    volume_mm3: float
    quality: str
    preview_png: bytes | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportData:
    """All that a report says, finished; it can be pickled."""

    figures: LotFigures
    created_at: str  # RFC 3339 UTC
    language: Language = Language.ENGLISH
    software_version: str
    api_version: str
    verification: EndedVerification | None = None
    is_verification_overdue: bool = False
    uncertainty_remark: str | None = None  # of this rig, beside the statement that every report has
    sievings: Sequence[StoredSieving] = ()
    gallery: Sequence[GalleryStone] = ()
    plant: PlantSettings = field(default_factory=PlantSettings)
    logo_svg: str | None = None
    signer: str | None = None  # fingerprint of the key that signs the file; None: it is not signed
