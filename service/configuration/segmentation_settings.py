"""`[segmentation]` of the configuration: segmenter, model and parameters."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, ValidationInfo

from pipeline.errors import ModelError
from pipeline.segmentation.network import NetworkKind
from pipeline.segmentation.onnx_runtime import onnxruntime
from pipeline.segmentation.segmenter_choice import SegmenterKind
from pipeline.segmentation.subtraction import SegmentationParameters
from service.base.paths import resolve_path
from service.processing.models.networks import load_model, read_model
from service.processing.segmenters import SegmenterPlan


def _resolve_model(model: str, info: ValidationInfo) -> str:
    """Return the absolute path of a model; the name of one stays as it is."""
    is_path = model.endswith(".onnx") or "/" in model
    return str(resolve_path(Path(model), info)) if is_path else model


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentationSettings(SegmentationParameters):
    """The parameters of the pipeline, and which segmenter and model are used."""

    segmenter: SegmenterKind = "auto"
    model: Annotated[str, AfterValidator(_resolve_model)] = ""
    """The name of a fetched model, or a path; empty: the built-in one."""
    providers: tuple[str, ...] = ()
    """Of onnxruntime, the first usable one is taken; default: CUDA if available, else the CPU."""

    @property
    def parameters(self) -> SegmentationParameters:
        """Return the parameters of the pipeline."""
        return SegmentationParameters(
            **{each.name: getattr(self, each.name) for each in fields(SegmentationParameters)}
        )


def plan_segmenter(settings: SegmentationSettings) -> SegmenterPlan:
    """Read the model and try it; the plan says why it cannot be used."""
    try:
        network = load_model(settings.model)
        model = read_model(settings.model)
        if settings.segmenter == "mask" and network.kind is not NetworkKind.U2NET:
            raise ModelError(f"segmenter mask needs a U2-Net as model, which {network.name} is not")
    except ModelError as err:
        return SegmenterPlan(wanted=settings.segmenter, trouble=str(err))
    built_in = onnxruntime.get_available_providers()
    lacking = [name for name in settings.providers if name not in built_in]
    trouble = f"this onnxruntime has no {', '.join(lacking)}, but {', '.join(built_in)}" if lacking else None
    return SegmenterPlan(
        wanted=settings.segmenter, model=model, providers=settings.providers, provider_trouble=trouble
    )
