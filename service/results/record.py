"""Make the result record: one flat dictionary, the same in `results.jsonl` and in the REST feed."""

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Any

from pipeline.fall import extent_is_plausible, vertical_extent_mm
from pipeline.frames import CameraId, Trigger
from pipeline.particle import HullMeasurement, ParticleMeasurement, ParticleResult
from pipeline.segmentation.optics import ViewOptics
from service.results.fields import EMPTY, MEASURED_FIELDS, STORED_FIELDS, Hull, Outcome
from service.results.version import ALGORITHM_VERSION

OPTICS_DIGITS = {
    "brightness": 4, "gradient_uv": 4, "dust": 4, "spots_share": 4, "saturated_share": 5, "noise_grey": 2,
    "edge_width_px": 2, "edge_widths_uv_px": 2, "contrast": 3,
}  # fmt: skip
"""Fields of `service.results.fields.RecordedOptics`, and the digits after the point that one exposure shows."""


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
    """Return the record of a bundle that was processed: `measured`, or `rejected` with the reason."""
    measurement, rejection, compared = result.measurement, result.rejection, result.consistency
    record = _base(trigger, bundle, calibration_id, is_simulated)
    record |= {
        "outcome": str(Outcome.REJECTED if measurement is None else Outcome.MEASURED),
        "reason": None if rejection is None else str(rejection.reason),
        "detail": None if rejection is None else rejection.detail,
        "quality": None if result.quality is None else str(result.quality),
        "quality_causes": [str(cause) for cause in result.quality_causes],
        "views": list(result.views),
        "dropped_views": {camera: str(why) for camera, why in result.dropped.items()},
        "segmenters": {camera: str(seen.found_by) for camera, seen in result.silhouettes.items()},
        "segmentation_flags": {
            camera: seen.fallback for camera, seen in result.silhouettes.items() if seen.fallback is not None
        },
        "view_residuals_px": _rounded_each(result.residuals_px),
        "tangency_px": {} if compared is None else _rounded_each(compared.tangency_px),
        "image_shifts_px": {} if compared is None else _rounded_each(compared.image_shifts_px),
        "optics": optics_record(result.optics),
        "timings_ms": timings_ms,
    }
    if measurement is not None:
        record |= _measured(measurement)
    return record | _gate_extent(trigger, measurement, speed_at_gate_mm_s)


def optics_record(optics: Mapping[CameraId, ViewOptics]) -> dict[str, Any]:
    """Return the field `optics` of a record, rounded to the precision of one exposure."""
    return {
        camera: {name: _rounded(getattr(seen, name), digits) for name, digits in OPTICS_DIGITS.items()}
        for camera, seen in optics.items()
    }


def _rounded_each(px_by_camera: Mapping[CameraId, Any]) -> dict[str, Any]:
    """Return residuals or shifts of all cameras, dropped ones included, in px."""
    return {camera: _rounded(px, 4) for camera, px in px_by_camera.items()}


def _rounded(value: float | Iterable[float] | None, digits: int) -> float | list[float] | None:
    if value is None or isinstance(value, float | int):
        return None if value is None else round(value, digits)
    return [round(each, digits) for each in value]


def lost_record(
    trigger: Trigger, *, bundle: str, reason: str, detail: str, calibration_id: str, is_simulated: bool
) -> dict[str, Any]:
    """Return the record of a trigger whose bundle was never processed; `reason` is a `LossReason`."""
    record = _base(trigger, bundle, calibration_id, is_simulated)
    return record | {"outcome": str(Outcome.LOST), "reason": str(reason), "detail": detail}


def _base(trigger: Trigger, bundle: str, calibration_id: str, is_simulated: bool) -> dict[str, Any]:
    """Return all fields but those of the store, in the order of the contract, nothing measured yet."""
    empty = {name: value for name, value in EMPTY.items() if name not in STORED_FIELDS}
    return empty | {
        "bundle": bundle,
        "sequence": trigger.sequence,
        "kind": str(trigger.kind),
        "n_stones": trigger.n_stones,
        "captured_at": trigger.utc,
        "calibration_id": calibration_id,
        "algorithm_version": ALGORITHM_VERSION,
        "is_simulated": is_simulated,
    }


def _measured(measurement: ParticleMeasurement) -> dict[str, Any]:
    """Return the measured fields: attributes of the particle, else of its shape."""
    return {
        name: _plain(getattr(measurement if hasattr(measurement, name) else measurement.shape, name))
        for name in MEASURED_FIELDS
    }


def _plain(value: Any) -> Any:
    """Return the value in types that JSON has."""
    match value:
        case HullMeasurement():
            return {name: getattr(value, name) for name in Hull.model_fields}
        case tuple():
            return list(value)
        case StrEnum():
            return str(value)
    return value


def _gate_extent(
    trigger: Trigger, measurement: ParticleMeasurement | None, speed_at_gate_mm_s: float
) -> dict[str, Any]:
    """Return the extent seen by the light gate, and whether it fits the body.

    A stone turns as it falls, so its Feret diameters bound the extent.
    """
    if trigger.pulse_width_ns is None:
        return {}
    extent_mm = vertical_extent_mm(trigger.pulse_width_ns, speed_at_gate_mm_s)
    found: dict[str, Any] = {"gate_extent_mm": extent_mm}
    if measurement is not None:
        ferets_mm = (measurement.shape.min_feret_mm, measurement.shape.max_feret_mm)
        found["gate_extent_is_plausible"] = extent_is_plausible(extent_mm, ferets_mm)
    return found
