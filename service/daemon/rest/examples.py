"""Examples of the main requests and answers, for the OpenAPI document; a test validates each by its model."""

from collections.abc import Mapping
from typing import Any

from service.calibration.verifications import VerificationRequest
from service.lots.lots import LotDocument
from service.lots.products import ProductDefinition
from service.lots.routes.laboratory import SievingRequest
from service.lots.routes.lots import AssignRequest, CloseRequest, LotRequest, VoidRequest
from service.lots.trends.diary import DiaryRequest
from service.particles.routes.particles import Pin
from service.particles.routes.results import ResultsPage
from service.recording.recordings import RecordingRequest
from service.web.problems import ProblemDocument
from service.web.routes.consumers import Cursor

INSTANCE_ID = "141fc8a1-0136-4f71-9b89-bda3f11805d3"
MEASURED = {
    "seq": 1,
    "id": "141fc8a1-00000001",
    "revision": 1,
    "kind": "particle",
    "captured_at": "2026-03-01T06:00:12.345Z",
    "outcome": "measured",
    "sieve_size_mm": 11.92,
    "mass_g": 3.1,
    "is_simulated": False,
    "is_replay": False,
}
REJECTED = MEASURED | {
    "seq": 2,
    "id": "141fc8a1-00000002",
    "captured_at": "2026-03-01T06:00:13.120Z",
    "outcome": "rejected",
    "sieve_size_mm": None,
    "mass_g": None,
}

EXAMPLES: Mapping[type, Mapping[str, Any]] = {
    ProductDefinition: {
        "title": "8/16 basalt",
        "density_kg_m3": 2850,
        "lower_mm": 8,
        "upper_mm": 16,
        "specification": "GC85-20",
        "flakiness_category": "FI20",
    },
    LotRequest: {"lot": "L-1207", "product": "basalt-8-16", "equipment": "crusher-2", "sampler": "A. Miller"},
    CloseRequest: {"tonnage_t": 24.5},
    DiaryRequest: {"kind": "gap", "value": 25, "text": "worn bars", "at": "2026-03-01T06:10:00Z"},
    VoidRequest: {"reason": "wrong belt"},
    AssignRequest: {"since": "2026-03-01T06:00:00Z", "until": "2026-03-01T06:40:00Z"},
    LotDocument: {
        "lot": "L-1207",
        "state": "open",
        "product": "basalt-8-16",
        "product_version": 1,
        "equipment": "crusher-2",
        "sublot": None,
        "sample_id": None,
        "sampler": "A. Miller",
        "external_id": "4500012345/10",
        "order": None,
        "customer": None,
        "tonnage_t": None,
        "remark": None,
        "opened_at": "2026-03-01T06:00:00.000Z",
        "closed_at": None,
        "void_reason": None,
        "revision": 0,
        "n_stones": 312,
        "in_progress": 1,
        "completion": None,
        "reached": None,
    },
    SievingRequest: {"retained_g": {"16": 12.5, "12.5": 410.0, "8": 530.5}, "pan_g": 21.0, "by": "B. Smith"},
    Cursor: {"after": 1234},
    Pin: {"is_pinned": True, "reason": "sent to the laboratory"},
    RecordingRequest: {"name": "belt-2-morning", "count": 100, "pre_trigger": 2},
    VerificationRequest: {"diameter_mm": 15.0, "count": 5, "by": "A. Miller"},
    ResultsPage: {
        "instance_id": INSTANCE_ID,
        "first_seq": 1,
        "last_seq": 2,
        "next_after": 2,
        "items": [MEASURED, REJECTED],
    },
    ProblemDocument: {
        "type": "urn:stonefall:problem:cursor-ahead",
        "title": "The cursor is ahead of the history",
        "status": 409,
        "detail": "the newest result is 2, not 99",
        "instance": "/api/v1/results",
        "request_id": "5f0c2a3e-8f0b-4f6e-9d3b-0a6a2f5d7c11",
        "first_seq": 1,
        "last_seq": 2,
    },
}
