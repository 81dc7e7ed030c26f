"""What is said of a whole lot in one line: its verdict, and what became of its stones."""

from pydantic import Field

from pipeline.gradation.specification import Verdict
from service.base.schema import Time
from service.base.status import Report


class LotVerdict(Report):
    """Verdict on a lot, and the stones that it rests on."""

    verdict: Verdict | None = Field(description="Null without a specification")
    is_partial: bool = Field(description="True when some figures of the specification were not measured")
    measured: int = Field(description="Stones with a body and its measures")


class ReachedVerdict(LotVerdict):
    """The verdict of an open lot: more stones may change it, and with each look at them chance has another one."""

    at: Time = Field(description="When it was reached, RFC 3339 UTC")


class LotOutcome(LotVerdict):
    """Verdict on a lot, and what became of the stones that fell."""

    rejected: int = Field(description="Stones whose views were found unfit")
    lost: int = Field(description="Stones whose views were never looked at")


class LotCompletion(LotOutcome):
    """What was said of a closed lot once all its stones had outcomes: final for this revision."""

    revision: int = Field(
        description="Revision of the lot that this is of; of an older one while it is made anew"
    )
    at: Time = Field(description="When it was completed, RFC 3339 UTC")
    report: str = Field(
        description="Path of the issued report, a PDF that stays as it is; below `[api] path_prefix`"
    )
    report_sha256: str = Field(description="SHA-256 of this report, in hexadecimal digits")
