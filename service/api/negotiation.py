"""Content negotiation and caching, as far as immutable files need them (RFC 9110, sections 12.5.1 and 13)."""

from collections.abc import Sequence

FOREVER = "private, max-age=31536000, immutable"


def best_match(accept: str | None, offers: Sequence[str]) -> int | None:
    """Index of the media type the client likes best, the earlier among equals; None when it wants none."""
    ranges = [_parse(part) for part in (accept or "*/*").split(",") if part.strip()]
    weights = [_weight(offer, ranges) for offer in offers]
    best = max(weights)
    return weights.index(best) if best > 0 else None


def names_etag(if_none_match: str | None, etag: str) -> bool:
    """Whether the client has this version already."""
    tags = [tag.strip().removeprefix("W/") for tag in (if_none_match or "").split(",")]
    return etag in tags or "*" in tags


def _parse(part: str) -> tuple[str, float]:
    media_range, *parameters = (piece.strip().lower() for piece in part.split(";"))
    for parameter in parameters:
        if parameter.startswith("q="):
            try:
                return media_range, float(parameter[2:])
            except ValueError:
                return media_range, 0.0
    return media_range, 1.0


def _weight(offer: str, ranges: Sequence[tuple[str, float]]) -> float:
    """Return the weight of the most specific range that covers the offer."""
    weights = dict(ranges)
    for media_range in (offer, f"{offer.split('/')[0]}/*", "*/*"):
        if media_range in weights:
            return weights[media_range]
    return 0.0
