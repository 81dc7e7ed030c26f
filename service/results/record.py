"""Make the result of a trigger: typed from measuring to the store, then one flat JSON object, the same everywhere.

`results.jsonl` lacks what a result gets when it becomes durable; until then that has the values of `NOT_DURABLE`.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from pipeline.body_measurement import ParticleMeasurement
from pipeline.fall import extent_is_plausible, vertical_extent_mm
from pipeline.frames import CameraId, Trigger
from pipeline.particle import ParticleResult
from pipeline.view_optics import ViewOptics
from service.results.fields import MEASURED_FIELDS, STORED_FIELDS, DensitySource, Hull, Outcome, Result
from service.results.version import ALGORITHM_VERSION

NOT_DURABLE = {"seq": 0, "id": "", "session": 0, "recorded_at": ""}
"""What a result has of what the store gives it, until then."""
OF_PARTICLE = frozenset(dir(ParticleMeasurement))
"""Attributes of the particle; other measured fields are those of its shape."""
OPTICS_DIGITS = {
    "brightness": 4, "gradient_uv": 4, "dust": 4, "spots_share": 4, "saturated_share": 5, "noise_grey": 2,
    "edge_width_px": 2, "edge_widths_uv_px": 2, "contrast": 3,
}  # fmt: skip
"""Fields of `pipeline.view_optics.ViewOptics`, and the digits after the point that one exposure shows."""


def result_of(document: Mapping[str, Any]) -> Result:
    """Return the result that is not durable yet and that this JSON object describes."""
    return Result.model_validate({**NOT_DURABLE, **document})


def document_of(result: Result) -> dict[str, Any]:
    """Return a result as a JSON object without what it gets when it becomes durable."""
    document = result.model_dump(exclude=set(STORED_FIELDS))
    return document if result.verification is None else document | {"verification": result.verification}


def result_record(
    result: ParticleResult,
    trigger: Trigger,
    *,
    bundle: str,
    calibration_id: str,
    is_simulated: bool,
    speed_at_gate_mm_s: float,
    timings_ms: dict[str, float],
) -> Result:
    """Return the result of a bundle that was processed: `measured`, or `rejected` with the reason."""
    measurement, rejection, compared = result.measurement, result.rejection, result.consistency
    return result_of(
        {
            **_fall(trigger, bundle, calibration_id, is_simulated),
            "outcome": Outcome.REJECTED if measurement is None else Outcome.MEASURED,
            "reason": None if rejection is None else str(rejection.reason),
            "detail": None if rejection is None else rejection.detail,
            "quality": result.quality,
            "quality_causes": list(result.quality_causes),
            "views": list(result.views),
            "dropped_views": {camera: str(why) for camera, why in result.dropped.items()},
            "segmenters": {camera: str(seen.found_by) for camera, seen in result.silhouettes.items()},
            "segmentation_flags": {
                camera: seen.fallback
                for camera, seen in result.silhouettes.items()
                if seen.fallback is not None
            },
            "view_residuals_px": _rounded_each(result.residuals_px),
            "tangency_px": {} if compared is None else _rounded_each(compared.tangency_px),
            "image_shifts_px": {} if compared is None else _rounded_each(compared.image_shifts_px),
            "optics": optics_record(result.optics),
            "timings_ms": timings_ms,
            **({} if measurement is None else _measured(measurement)),
            **_gate_extent(trigger, measurement, speed_at_gate_mm_s),
        }
    )


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
) -> Result:
    """Return the result of a trigger whose bundle was never processed; `reason` is a `LossReason`."""
    fall = _fall(trigger, bundle, calibration_id, is_simulated)
    return result_of({**fall, "outcome": Outcome.LOST, "reason": str(reason), "detail": detail})


def _fall(trigger: Trigger, bundle: str, calibration_id: str, is_simulated: bool) -> dict[str, Any]:
    return {
        "bundle": bundle,
        "sequence": trigger.sequence,
        "kind": trigger.kind,
        "n_stones": trigger.n_stones,
        "captured_at": trigger.utc,
        "calibration_id": calibration_id,
        "algorithm_version": ALGORITHM_VERSION,
        "is_simulated": is_simulated,
    }


def _measured(measurement: ParticleMeasurement) -> dict[str, Any]:
    """Return the measured fields: attributes of the particle, else of its shape."""
    hull = {name: getattr(measurement.hull, name) for name in Hull.model_fields}
    sources = {name: measurement if name in OF_PARTICLE else measurement.shape for name in MEASURED_FIELDS}
    source = None if measurement.density_kg_m3 is None else DensitySource.CONFIGURATION
    found = {name: getattr(each, name) for name, each in sources.items()}
    return found | {"hull": hull, "density_source": source}


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
