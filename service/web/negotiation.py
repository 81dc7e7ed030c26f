"""Content negotiation by the `Accept` header (RFC 9110, section 12.5.1)."""

from collections.abc import Mapping
from typing import TypeVar

from fastapi import Request

from service.web.problems import Problem

T = TypeVar("T")


def negotiated(request: Request, offers: Mapping[T, str], thing: str) -> T:
    """Return the offer whose media type the `Accept` header prefers, the first among equals; raise the problem 406."""
    accept = request.headers.get("accept") or "*/*"
    ranges = dict(_media_range(part) for part in accept.split(",") if part.strip())
    weights = {offer: _weight(media_type, ranges) for offer, media_type in offers.items()}
    best = max(weights, key=weights.__getitem__)
    if weights[best] > 0:
        return best
    detail = f"{thing} comes as {', '.join(offers.values())}"
    raise Problem(406, "not-acceptable", detail, headers={"Vary": "Accept"})


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
