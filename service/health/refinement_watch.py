"""Watch how much the pixels inside the outlines say of the stones, and whether there is time to look at them.

Wet, dusty or dark stones, dirty windows and less light leave fewer pixels that tell how deep the surface lies; a rush
leaves no time to look. Either way stones are measured by their outlines, which show no dents. The record of each stone
says so; here is the trend.
"""

from collections import deque
from dataclasses import dataclass
from statistics import median

from service.base.messages import Code, CodedText, joined, message
from service.base.status import Checks, trouble_check
from service.results.fields import RUSH, Result

WINDOW = 100
"""Latest stones that are judged; nothing is said before there are so many."""
MIN_LOOKED_AT = 20
"""Fewest stones among them with a meaningful median."""
REFERENCE = 300
"""Stones at the beginning of the run that the latest ones are compared with."""
RUSHED_SHARE = 0.5
"""Share of stones left out in a rush above which the machine is too slow."""
FALLEN_SHARE = 0.5
"""Share of the reference below which pixels say too little."""
HYSTERESIS = 0.8
"""How far a figure must come back before its warning ends, because stones differ."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinementTrend:
    """Figures of the latest stones; None while they are too few, or none is to be refined."""

    supported_share: float | None = None  # of the surface: median of the stones that were looked at
    reference_share: float | None = None  # the same of the first stones of the run
    rushed_share: float | None = None  # of the stones: they were not looked at in a rush
    is_rushed: bool = False
    has_fallen: bool = False

    @property
    def warning(self) -> CodedText | None:
        """Why dents are not seen, with the remedy; None if they are, as far as stones have any texture."""
        warnings = []
        if self.is_rushed:
            warnings.append(message(Code.REFINEMENT_RUSHED, percent=100 * (self.rushed_share or 0.0)))
        if self.has_fallen:
            percent, before = (100 * (share or 0.0) for share in (self.supported_share, self.reference_share))
            warnings.append(message(Code.REFINEMENT_FALLEN, percent=percent, reference_percent=before))
        return joined(warnings)


class RefinementWatch:
    """Watches what pixels say of the stones: `feed` it all results, in their order, and read the `trend`."""

    def __init__(self) -> None:
        self.trend = RefinementTrend()
        self._first: list[float] = []
        self._latest: deque[float | None] = deque(maxlen=WINDOW)  # None: not looked at in a rush

    def feed(self, record: Result) -> None:
        """Take one result into account, unless its body was not to be refined, or is a ball's, without texture."""
        share = record.supported_share
        is_rushed = record.refinement_fallback == RUSH
        if record.kind == "ball" or (share is None and not is_rushed):
            return
        self._latest.append(share)
        if share is not None and len(self._first) < REFERENCE:
            self._first.append(share)
        if len(self._latest) == WINDOW:
            self.trend = self._judged(self.trend)

    def checks(self) -> Checks:
        """Check whether there is time to look for dents, and whether pixels show as much as they did."""
        share = self.trend.supported_share
        shown = None if share is None else round(share, 3)
        return {"refinement": trouble_check(self.trend.warning, shown, "share")}

    def _judged(self, before: RefinementTrend) -> RefinementTrend:
        looked_at = [share for share in self._latest if share is not None]
        rushed_share = 1 - len(looked_at) / WINDOW
        supported_share, has_fallen = before.supported_share, before.has_fallen
        reference_share = median(self._first) if len(self._first) == REFERENCE else None
        if len(looked_at) >= MIN_LOOKED_AT:
            supported_share = median(looked_at)
            if reference_share is not None:
                least_share = FALLEN_SHARE * reference_share
                has_fallen = supported_share * (HYSTERESIS if has_fallen else 1) < least_share
        return RefinementTrend(
            supported_share=supported_share,
            reference_share=reference_share,
            rushed_share=rushed_share,
            is_rushed=rushed_share > RUSHED_SHARE * (HYSTERESIS if before.is_rushed else 1),
            has_fallen=has_fallen,
        )
