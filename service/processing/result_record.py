"""The result record: one flat dictionary, the same in `results.jsonl` and in the REST feed."""

from collections.abc import Mapping
from typing import Any

from pipeline.fall import extent_is_plausible, vertical_extent_mm
from pipeline.frames import CameraId, Trigger
from pipeline.particle import ParticleMeasurement, ParticleResult
from pipeline.segmentation.optics import ViewOptics

ALGORITHM_VERSION = "9"
"""Raised by every change that may change a result."""

MEASURED_FIELDS = (
    "body",
    "volume_mm3",
    "volume_raw_mm3",
    "volume_estimate_mm3",
    "volume_model",
    "surface_area_mm2",
    "length_mm",
    "width_mm",
    "thickness_mm",
    "max_feret_mm",
    "min_feret_mm",
    "min_box_mm",
    "sieve_size_mm",
    "equivalent_diameter_mm",
    "equivalent_diameter_raw_mm",
    "sphericity",
    "convexity",
    "elongation_ratio",
    "flatness_ratio",
    "zingg_class",
    "angularity",
    "mass_g",
    "center_mm",
    "hull",
)
"""Fields that are null unless the outcome is `measured`."""


def result_record(
    result: ParticleResult,
    trigger: Trigger,
    *,
    bundle: str,
    calibration_id: str,
    is_simulated: bool,
    speed_at_gate_mm_s: float,
    timings_ms: dict[str, float],
) -> dict[str, Any]:
    """The record of a bundle that was looked at: `measured`, or `rejected` with the reason."""
    measurement, rejection = result.measurement, result.rejection
    record = _frame(trigger, bundle, calibration_id, is_simulated)
    record |= {
        "outcome": "rejected" if measurement is None else "measured",
        "reason": None if rejection is None else str(rejection.reason),
        "detail": None if rejection is None else rejection.detail,
        "quality": None if result.quality is None else str(result.quality),
        "views": list(result.views),
        "dropped_views": dict(result.dropped),
        "segmenters": {camera: str(seen.found_by) for camera, seen in result.silhouettes.items()},
        "segmentation_flags": {
            camera: seen.fallback for camera, seen in result.silhouettes.items() if seen.fallback is not None
        },
        "view_residuals_px": {camera: round(px, 4) for camera, px in result.residuals_px.items()},
        **_tangency(result),
        "optics": optics_record(result.optics),
        "timings_ms": timings_ms,
    }
    if measurement is not None:
        record |= _measured(measurement)
    return record | _at_the_gate(trigger, measurement, speed_at_gate_mm_s)


def _tangency(result: ParticleResult) -> dict[str, Any]:
    """What the stone says about the cameras, those it was rejected for included."""
    if result.consistency is None:
        return {}
    found = result.consistency
    return {
        "tangency_px": {camera: round(px, 4) for camera, px in found.tangency_px.items()},
        "image_shifts_px": {
            camera: [round(px, 4) for px in shift] for camera, shift in found.image_shifts_px.items()
        },
    }


def optics_record(optics: Mapping[CameraId, ViewOptics]) -> dict[str, Any]:
    """How well each camera sees, rounded to what can be told from one exposure."""
    return {
        camera: {
            "brightness": round(seen.brightness, 4),
            "gradient_uv": [round(slope, 4) for slope in seen.gradient_uv],
            "dust": round(seen.dust, 4),
            "spots_share": round(seen.spots_share, 4),
            "saturated_share": round(seen.saturated_share, 5),
            "noise_grey": round(seen.noise_grey, 2),
            "edge_width_px": None if seen.edge_width_px is None else round(seen.edge_width_px, 2),
            "contrast": None if seen.contrast is None else round(seen.contrast, 3),
        }
        for camera, seen in optics.items()
    }


def lost_record(
    trigger: Trigger | None, *, bundle: str, reason: str, detail: str, calibration_id: str, is_simulated: bool
) -> dict[str, Any]:
    """The record of a trigger whose bundle was never looked at; `None` when even its header cannot be read."""
    record = _frame(trigger, bundle, calibration_id, is_simulated)
    return record | {"outcome": "lost", "reason": reason, "detail": detail}


def _frame(trigger: Trigger | None, bundle: str, calibration_id: str, is_simulated: bool) -> dict[str, Any]:
    """What every record has, with everything measured still null, in the order of the contract."""
    return {
        "bundle": bundle,
        "sequence": None if trigger is None else trigger.sequence,
        "kind": None if trigger is None else str(trigger.kind),
        "captured_at": None if trigger is None else trigger.utc,
        "outcome": None,
        "reason": None,
        "detail": None,
        "quality": None,
        "views": [],
        "dropped_views": {},
        "segmenters": {},
        "segmentation_flags": {},
        **dict.fromkeys(MEASURED_FIELDS),
        "gate_extent_mm": None,
        "gate_extent_is_plausible": None,
        "mesh": None,
        "view_residuals_px": {},
        "tangency_px": {},
        "image_shifts_px": {},
        "optics": {},
        "timings_ms": {},
        "calibration_id": calibration_id,
        "algorithm_version": ALGORITHM_VERSION,
        "is_simulated": is_simulated,
    }


def _measured(measurement: ParticleMeasurement) -> dict[str, Any]:
    shape, hull = measurement.shape, measurement.hull
    return {
        "body": measurement.body,
        "volume_mm3": measurement.volume_mm3,
        "volume_raw_mm3": hull.volume_mm3,
        "volume_estimate_mm3": measurement.volume_estimate_mm3,
        "volume_model": measurement.volume_model,
        "surface_area_mm2": shape.surface_area_mm2,
        "length_mm": shape.length_mm,
        "width_mm": shape.width_mm,
        "thickness_mm": shape.thickness_mm,
        "max_feret_mm": shape.max_feret_mm,
        "min_feret_mm": shape.min_feret_mm,
        "min_box_mm": list(shape.min_box_mm),
        "sieve_size_mm": shape.sieve_size_mm,
        "equivalent_diameter_mm": measurement.equivalent_diameter_mm,
        "equivalent_diameter_raw_mm": hull.equivalent_diameter_mm,
        "sphericity": shape.sphericity,
        "convexity": shape.convexity,
        "elongation_ratio": shape.elongation_ratio,
        "flatness_ratio": shape.flatness_ratio,
        "zingg_class": str(shape.zingg_class),
        "angularity": measurement.angularity,
        "mass_g": measurement.mass_g,
        "center_mm": list(shape.center_mm),
        "hull": {
            "volume_mm3": hull.volume_mm3,
            "surface_area_mm2": hull.surface_area_mm2,
            "equivalent_diameter_mm": hull.equivalent_diameter_mm,
        },
    }


def _at_the_gate(
    trigger: Trigger, measurement: ParticleMeasurement | None, speed_at_gate_mm_s: float
) -> dict[str, Any]:
    """What closed the beam, against what was measured: it turns as it falls, so its diameters bound the extent."""
    if trigger.pulse_width_ns is None:
        return {}
    extent_mm = vertical_extent_mm(trigger.pulse_width_ns, speed_at_gate_mm_s)
    found: dict[str, Any] = {"gate_extent_mm": extent_mm}
    if measurement is not None:
        ferets_mm = (measurement.shape.min_feret_mm, measurement.shape.max_feret_mm)
        found["gate_extent_is_plausible"] = extent_is_plausible(extent_mm, ferets_mm)
    return found
