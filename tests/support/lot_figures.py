"""Figures of a lot made by hand, and the data of its report: an 8/16 that conforms but for one undecided sieve."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from pipeline.gradation.budget import UncertaintyBudget
from pipeline.gradation.d4791 import FlatAndElongated, FlatAndElongatedFraction
from pipeline.gradation.estimates import Estimate, State
from pipeline.gradation.indices import INDICES, ShapeIndices
from pipeline.gradation.specification import Decision, Range, Verdict
from pipeline.gradation.stones import Unmeasured
from service.lots.figures import (
    CorrelatedCurve,
    CorrelatedStep,
    CurveStep,
    LotFigures,
    ProductDocument,
    Quantile,
)
from service.lots.laboratory import Sieving, StoredSieving
from service.lots.lots import LotDocument, LotState
from service.lots.plant import PlantSettings
from service.reports.report import (
    EndedVerification,
    GalleryReason,
    GalleryStone,
    ReportData,
    VerificationOutcome,
)

NOT_MEASURED = Estimate(state=State.NOT_MEASURED)


def measured(value: float, standard_error: float = 1.0, state: State = State.MEASURED) -> Estimate:
    """A figure with an interval of two standard errors."""
    return Estimate(
        state=state,
        value=value,
        low=value - 2 * standard_error,
        high=value + 2 * standard_error,
        standard_error=standard_error,
        sampling_se=0.9 * standard_error,
        measuring_se=0.3 * standard_error,
        systematic_se=0.3 * standard_error,
        n_effective=640.0,
    )


def budget(figure: str, value: float, combined: float) -> UncertaintyBudget:
    """The budget of a figure, most of it sampling."""
    return UncertaintyBudget(
        figure=figure,
        value=value,
        sampling=0.9 * combined,
        instrument=0.4 * combined,
        scale=0.1732 * combined,
        combined=combined,
        coverage_factor=2.0,
        expanded=2 * combined,
        interval_factor=1.97,
    )


def decision(
    verdict: Verdict, low: float, high: float, more_stones: int | None = None, more_s: float | None = None
) -> Decision:
    limits = Range(min_percent=float(low), max_percent=float(high))
    return Decision(verdict=verdict, limits=limits, more_stones=more_stones, more_s=more_s)


def step(sieve_mm: float, passing: Estimate, decided: Decision | None = None) -> CurveStep:
    """One sieve; half as much passes again by number."""
    by_number = passing if passing.value is None else measured(min(100.0, 1.2 * passing.value), 0.8)
    return CurveStep(
        sieve_mm=sieve_mm, passing_percent=passing, passing_by_number_percent=by_number, decision=decided
    )


def curve() -> list[CurveStep]:
    """EN 933-1 basic set + set 2, GC90/15 of 8/16; the smaller sieves are out of the range."""
    return [
        step(1.0, NOT_MEASURED),
        step(2.0, NOT_MEASURED, decision(Verdict.NOT_MEASURED, 0, 2)),
        step(4.0, measured(3.9, 0.7), decision(Verdict.UNDECIDED, 0, 5, 220, 55.0)),
        step(6.3, measured(6.0, 0.8)),
        step(8.0, measured(11.2, 1.0), decision(Verdict.CONFORMS, 0, 15)),
        step(10.0, measured(34.6, 1.9)),
        step(12.5, measured(61.3, 2.1)),
        step(14.0, measured(79.0, 1.7)),
        step(16.0, measured(94.2, 1.0), decision(Verdict.CONFORMS, 90, 99)),
        step(20.0, measured(99.4, 0.3)),
        step(22.4, measured(100.0, 0.0), decision(Verdict.CONFORMS, 98, 100)),
        step(31.5, measured(100.0, 0.0), decision(Verdict.CONFORMS, 100, 100)),
    ]


def lot_document(**changes: Any) -> LotDocument:
    given: dict[str, Any] = {
        "lot": "2026-04711",
        "state": LotState.CLOSED,
        "product": "basalt-8-16",
        "product_version": 3,
        "equipment": "line 2, below screen 3",
        "sublot": "B",
        "sample_id": "S-0815",
        "external_id": "4500012345/10",
        "order": "Los 12",
        "customer": "Betonwerk Süd",
        "sampler": "J. Müller",
        "tonnage_t": 412.5,
        "remark": "Größe nach dem Wechsel der Siebe geprüft",
        "opened_at": "2026-11-20T06:02:11.120Z",
        "closed_at": "2026-11-20T06:58:40.004Z",
        "void_reason": None,
        "revision": 1,
        "n_stones": 1012,
    }
    return LotDocument(**given | changes)


def indices() -> ShapeIndices:
    sizes = ((8.0, 10.0, 23.4, 410), (10.0, 12.5, 26.7, 301), (12.5, 14.0, 17.7, 122), (14.0, 16.0, 15.2, 78))
    named = {
        "uniformity": measured(1.56, 0.03),
        "curvature": measured(1.02, 0.04),
        "graphic_mean_phi": measured(-3.4, 0.05),
        "graphic_sorting_phi": measured(0.52, 0.02),
        "graphic_skewness": measured(0.08, 0.03),
        "graphic_kurtosis": measured(1.01, 0.04),
        "d32_mm": measured(11.1, 0.12),
        "d43_mm": measured(12.06, 0.14),
        "flakiness_percent": measured(12.4, 1.3),
        "shape_percent": measured(18.9, 1.6),
        "needle_flaky_percent": measured(9.1, 1.1),
    }
    return ShapeIndices(
        **dict.fromkeys(INDICES, NOT_MEASURED) | named,
        flat_and_elongated=forms(1.0),
        flat_and_elongated_fractions=[
            FlatAndElongatedFraction(
                lower_mm=lower_mm,
                upper_mm=upper_mm,
                mass_percent=mass_percent,
                n_stones=n_stones,
                forms=forms(14 / upper_mm),
            )
            for lower_mm, upper_mm, mass_percent, n_stones in sizes
        ],
        flat_and_elongated_weighted=forms(1.1),
    )


def forms(factor: float) -> list[FlatAndElongated]:
    """Shares of ASTM D4791, so many times those of the whole lot."""
    return [
        FlatAndElongated(
            ratio=ratio,
            flat_percent={"mass": measured(factor * 30 / ratio), "number": measured(factor * 33 / ratio)},
            elongated_percent={
                "mass": measured(factor * 24 / ratio),
                "number": measured(factor * 25 / ratio),
            },
            flat_and_elongated_percent={
                "mass": measured(factor * 60 / ratio, 2),
                "number": measured(factor * 66 / ratio, 2),
            },
        )
        for ratio in (2, 3, 5)
    ]


def lot_figures(**changes: Any) -> LotFigures:
    """Figures of the lot; a change replaces a field."""
    given: dict[str, Any] = {
        "lot": lot_document(),
        "product": ProductDocument(
            product="basalt-8-16",
            version=3,
            title="Basalt 8/16",
            density_kg_m3=2710.0,
            specification="EN 13043 GC90/15",
        ),
        "since": "2026-11-20T06:02:12.300Z",
        "until": "2026-11-20T06:58:39.410Z",
        "triggers": 1012,
        "measured": 987,
        "rejected": 21,
        "lost": 4,
        "by_quality": {"good": 951, "reduced": 30, "degraded": 6},
        "by_body": {"photo": 901, "estimate": 84, "hull": 2},
        "not_refined": {"rush": 71, "no_evidence": 13},
        "mass_kg": 3.12,
        "n_effective": 640.2,
        "sieve_set": "EN 933-1 + set 2",
        "specification": "EN 13043 GC90/15",
        "specification_source": "EN 13043:2002, table 2",
        "curve": curve(),
        "correlated": CorrelatedCurve(
            version=2,
            factor=1.01,
            n_lots=3,
            held_out_rmse=0.8,
            curve=[
                CorrelatedStep(sieve_mm=size_mm, passing_percent=measured(50.0)) for size_mm in (8.0, 10.0)
            ],
        ),
        "uncertainty": [
            budget("d50_mm", 12.0, 0.14),
            budget("flakiness_percent", 12.4, 1.3),
            budget("shape_percent", 18.9, 1.6),
        ],
        "quantiles": [
            Quantile(
                percent=percent,
                interpolated_mm=measured(size_mm, 0.1),
                exact_mm=measured(size_mm + 0.02, 0.08),
            )
            for percent, size_mm in ((10, 7.62), (30, 9.55), (50, 11.38), (60, 12.35), (90, 15.37))
        ],
        "indices": indices(),
        "flakiness_decision": decision(Verdict.CONFORMS, 0, 20),
        "shape_decision": decision(Verdict.UNDECIDED, 0, 20, 1900, 475.0),
        "verdict": Verdict.UNDECIDED,
        "is_partial": True,
        "countdown": "4 mm sieve undecided: about 220 stones, 55 s more",
        "unmeasured": Unmeasured(
            n_stones=25,
            by_reason={
                "rejected: clipped": 6,
                "rejected: multiple": 12,
                "rejected: unseen": 3,
                "lost: queue_full": 4,
            },
            expected_percent=2.5,
            at_most_percent=18.4,
        ),
        "least_portion_kg": 2.6,
        "scale_sd_percent": 0.043,
        "calibration_ids": ["0007-9f2c1a"],
        "algorithm_versions": ["10"],
        "is_simulated": False,
        "is_replay": False,
    }
    return LotFigures(**given | changes)


def preview_png(seed: int = 0, side_px: int = 96) -> bytes:
    """A grey stone before a light wall."""
    picture = np.full((side_px, side_px * 4 // 3), 225, np.uint8)
    rng = np.random.default_rng(seed)
    angles = np.linspace(0, 2 * np.pi, 9, endpoint=False)
    radii = side_px * rng.uniform(0.25, 0.45, 9)
    middle = np.array([side_px * 2 / 3, side_px / 2])
    corners = middle + np.stack([radii * np.cos(angles) * 1.2, radii * np.sin(angles)], 1)
    cv2.fillPoly(picture, [corners.astype(np.int32)], (90,))
    return bytes(cv2.imencode(".png", picture)[1])


def gallery() -> Sequence[GalleryStone]:
    reasons = [
        (GalleryReason.HEAVIEST, GalleryReason.LARGEST),
        (GalleryReason.HEAVIEST,),
        (GalleryReason.NEAREST_LIMIT,),
        (GalleryReason.NEAREST_LIMIT,),
        (GalleryReason.LARGEST,),
        (GalleryReason.MOST_ELONGATED,),
    ]
    return [
        GalleryStone(
            id=f"3f1c-00{i:04d}",
            reasons=why,
            sieve_size_mm=19.4 - 1.7 * i,
            volume_mm3=5210.0 - 700 * i,
            quality="good" if i else "reduced",
            preview_png=None if i == 4 else preview_png(i),
        )
        for i, why in enumerate(reasons)
    ]


def sieving() -> StoredSieving:
    retained_g = {4.0: 9.2, 8.0: 24.1, 10.0: 26.3, 12.5: 17.8, 14.0: 13.3, 16.0: 6.5, 22.4: 0.0}
    document = Sieving(
        retained_g=retained_g, pan_g=2.8, by="Labor Süd", sample_id="S-0815/2", remark="dried at 110 °C"
    )
    return StoredSieving(sieving=221, at="2026-11-20T11:30:00Z", document=document)


def report_data(figures: Mapping[str, Any] | None = None, **changes: Any) -> ReportData:
    """The data of a report; `figures` replaces fields of the figures, the rest those of the report."""
    data = ReportData(
        figures=lot_figures(**(figures or {})),
        created_at="2026-11-20T07:00:03.000Z",
        software_version="0.3.0",
        api_version="1.8.0",
        verification=EndedVerification(
            id="v-0031",
            at="2026-11-20T05:50:12.000Z",
            outcome=VerificationOutcome.PASSED,
            diameter_mm=15.0,
            error_mm=0.021,
        ),
        gallery=gallery(),
        sievings=(sieving(),),
        plant=PlantSettings(time_zone="UTC"),
    )
    return replace(data, **changes)
