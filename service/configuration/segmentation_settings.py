"""`[segmentation]` of the configuration: which segmenter is asked, with which model."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import onnxruntime
from pydantic import AfterValidator, ValidationInfo

from pipeline.errors import ModelError
from pipeline.segmentation.segmenter_choice import SegmenterKind
from pipeline.segmentation.subtraction import SegmentationParameters
from service.configuration.paths import resolve_path
from service.models.networks import load_model, read_model
from service.processing.segmenters import SegmenterPlan


def _resolve_model(model: str, info: ValidationInfo) -> str:
    """A path relative to the configuration's folder; names of models stay as they are."""
    is_path = model.endswith(".onnx") or "/" in model
    return str(resolve_path(Path(model), info)) if is_path else model


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentationSettings(SegmentationParameters):
    """The parameters of the pipeline, and which segmenter is asked."""

    segmenter: SegmenterKind = "auto"
    model: Annotated[str, AfterValidator(_resolve_model)] = ""  # built-in; the name of a fetched one; a path
    providers: tuple[str, ...] = ()  # of onnxruntime, the first that works; CUDA where there is, else the CPU

    @property
    def parameters(self) -> SegmentationParameters:
        """What the pipeline takes."""
        return SegmentationParameters(
            **{each.name: getattr(self, each.name) for each in fields(SegmentationParameters)}
        )


def plan_segmenter(settings: SegmentationSettings) -> SegmenterPlan:
    """Read the model and try whether it can be used."""
    try:
        load_model(settings.model)
        model = read_model(settings.model)
    except ModelError as err:
        return SegmenterPlan(wanted=settings.segmenter, trouble=str(err))
    built_in = onnxruntime.get_available_providers()
    lacking = [name for name in settings.providers if name not in built_in]
    return SegmenterPlan(
        wanted=settings.segmenter,
        model=model,
        providers=settings.providers,
        provider_trouble=f"this onnxruntime has no {', '.join(lacking)}, but {', '.join(built_in)}"
        if lacking
        else None,
    )
