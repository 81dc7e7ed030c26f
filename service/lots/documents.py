"""Figures and sievings as finished JSON, made on a connection to the store, in any process."""

import json
import sqlite3
from dataclasses import asdict
from typing import Any

from pydantic import BaseModel

from service.lots.evaluation import lot_figures, window_figures
from service.lots.laboratory import StoredSieving, sievings
from service.lots.stored_stones import Choice
from service.lots.yardsticks import Request


def lot_figures_json(
    connection: sqlite3.Connection, lot: str, request: Request, choice: Choice
) -> bytes | None:
    """Return the figures of a lot, or of a choice of its stones; None if there is none."""
    return _model_json(lot_figures(connection, lot, request, choice))


def window_figures_json(
    connection: sqlite3.Connection, since: str, until: str, request: Request, product: str | None
) -> bytes | None:
    """Return the figures of a time, None if the product is unknown."""
    return _model_json(window_figures(connection, since, until, request, product))


def sievings_json(connection: sqlite3.Connection, lot: str) -> bytes:
    """Return the sievings of a lot as JSON."""
    return json.dumps({"items": [sieving_document(each) for each in sievings(connection, lot)]}).encode()


def sieving_document(stored: StoredSieving) -> dict[str, Any]:
    """Return a sieving as its document says it."""
    sieving = stored.document
    return {
        **asdict(sieving),
        "sieving": stored.sieving,
        "at": stored.at,
        "mass_g": sieving.mass_g,
        "retained_g": {f"{sieve_mm:g}": grams for sieve_mm, grams in sieving.retained_g.items()},
        "passing_percent": {f"{sieve_mm:g}": share for sieve_mm, share in sieving.passing_percent.items()},
    }


def _model_json(model: BaseModel | None) -> bytes | None:
    return None if model is None else model.model_dump_json().encode()
