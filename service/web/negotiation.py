"""Content negotiation by the `Accept` header (RFC 9110, section 12.5.1)."""

from collections.abc import Sequence


def best_match(accept: str | None, offers: Sequence[str]) -> int | None:
    """Return the index of the offer that the `Accept` header prefers, the earlier among equals; None without one."""
    ranges = dict(_media_range(part) for part in (accept or "*/*").split(",") if part.strip())
    weights = [_weight(offer, ranges) for offer in offers]
    best = max(weights)
    return weights.index(best) if best > 0 else None


def _media_range(part: str) -> tuple[str, float]:
    """Return a media range of an `Accept` header and its weight; one that cannot be read weighs nothing."""
    media_range, *parameters = (piece.strip().lower() for piece in part.split(";"))
    for parameter in parameters:
        if parameter.startswith("q="):
            try:
                return media_range, float(parameter[2:])
            except ValueError:
                return media_range, 0.0
    return media_range, 1.0


def _weight(offer: str, ranges: dict[str, float]) -> float:
    """Return the weight of the most specific media range that covers the offer."""
    for media_range in (offer, f"{offer.split('/')[0]}/*", "*/*"):
        if media_range in ranges:
            return ranges[media_range]
    return 0.0
