"""Export of a trained network to the ONNX file that segmentation loads."""

import io
import warnings
from collections.abc import Mapping

import onnx
import torch
from torch import Tensor, nn

from pipeline.segmentation.network import FORMAT, SIZE_PX
from pipeline.training.architecture import BodyNetwork
from pipeline.training.image_layers import VIEW_PX
from pipeline.training.space_to_depth import to_space_to_depth

OPSET = 17


class _WithSigmoid(nn.Module):  # type: ignore[misc] # torch is not there when this is checked
    def __init__(self, network: BodyNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, view: Tensor) -> Tensor:
        return torch.sigmoid(self.network(view))


def to_onnx(network: BodyNetwork, metadata: Mapping[str, str]) -> bytes:
    """Return the network as an ONNX file: `view` 1x2xHxW in, `body` 1x1xHxW out, P(body) in 0..1.

    Batch normalization is folded into the convolutions. `metadata` is kept beside the format's name.
    """
    network = network.eval().to(memory_format=torch.contiguous_format)
    file = io.BytesIO()
    with warnings.catch_warnings():
        # the exporter that replaces this one needs onnxscript, and makes a larger graph of this small network
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            _WithSigmoid(network),
            (torch.zeros(1, 2, VIEW_PX, VIEW_PX),),
            file,
            opset_version=OPSET,
            input_names=["view"],
            output_names=["body"],
            dynamo=False,
        )
    model = to_space_to_depth(onnx.load_from_string(file.getvalue()))
    onnx.helper.set_model_props(model, {"format": FORMAT, SIZE_PX: str(VIEW_PX), **metadata})
    return bytes(model.SerializeToString())
