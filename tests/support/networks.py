"""Small ONNX files: a network that works (it compares with the wall) and ones that nobody can use."""

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
import onnx
from onnx import TensorProto, helper

from pipeline.arrays import Singles
from pipeline.segmentation.network import CPU, FORMAT, InferenceSession, StartSession, start_session
from pipeline.segmentation.onnx_runtime import runtime_errors

GPU = "CUDAExecutionProvider"

STEEPNESS = 60.0
"""Of the first logit, by the difference from the wall as a share of the plain wall."""
COVERAGE_STEEPNESS = 8.0
"""Of the second one, by the share of the pixel that is covered."""


@cache
def difference_network(
    edge_px: int | str = 256, *, threshold: float = 0.12, nearby_px: int = 7, **metadata: str
) -> bytes:
    """P(body) where the image differs from what is behind, by more than half of the difference nearby.

    Behind is the plain wall where nothing is known of it. With a `nearby_px` of 1 every difference is body. An edge
    that is no number is open.
    """
    pad = nearby_px // 2
    nodes = [
        helper.make_node("Split", ["view"], ["image", "given"], axis=1, num_outputs=2),
        helper.make_node("ReduceMax", ["given"], ["brightest"], keepdims=1),
        helper.make_node("Sign", ["brightest"], ["is_given"]),
        helper.make_node("Sub", ["one", "is_given"], ["lacks"]),
        helper.make_node("Add", ["given", "lacks"], ["behind"]),
        helper.make_node("Sub", ["behind", "image"], ["difference"]),
        helper.make_node("Abs", ["difference"], ["size"]),
        helper.make_node("MaxPool", ["size"], ["largest"], kernel_shape=[nearby_px] * 2, pads=[pad] * 4),
        helper.make_node("Add", ["largest", "little"], ["nearby"]),
        helper.make_node("Sub", ["nearby", "threshold"], ["above"]),
        helper.make_node("Mul", ["above", "steepness"], ["logit"]),
        helper.make_node("Sigmoid", ["logit"], ["is_near"]),
        helper.make_node("Div", ["size", "nearby"], ["coverage"]),
        helper.make_node("Sub", ["coverage", "half"], ["above_half"]),
        helper.make_node("Mul", ["above_half", "coverage_steepness"], ["coverage_logit"]),
        helper.make_node("Sigmoid", ["coverage_logit"], ["is_covered"]),
        helper.make_node("Mul", ["is_near", "is_covered"], ["body"]),
    ]
    constants = {
        "one": 1.0,
        "little": 1e-3,
        "half": 0.5,
        "threshold": threshold,
        "steepness": STEEPNESS,
        "coverage_steepness": COVERAGE_STEEPNESS,
    }
    edges = [edge_px] * 2 if isinstance(edge_px, int) else ["height", "width"]
    view = helper.make_tensor_value_info("view", TensorProto.FLOAT, [1, 2, *edges])
    body = helper.make_tensor_value_info("body", TensorProto.FLOAT, [1, 1, *edges])
    return _content(nodes, view, body, constants, {"format": FORMAT, "parameters": "5"} | metadata)


@cache
def darkness_network(size_px: int | str = 320, channels: int = 3, only_px: int = 1) -> bytes:
    """In the shape of a U2-Net, without metadata: the mean of the channels, turned over.

    With `only_px` it can be run for images of that size alone, which its shape does not tell.
    """
    nodes = [
        helper.make_node("ConstantOfShape", ["only_shape"], ["nothing"]),
        helper.make_node("ReduceMean", ["input.1", "axes"], ["mean"], keepdims=1),
        helper.make_node("Sub", ["nothing", "mean"], ["1959"]),
    ]
    shape = [1, channels, size_px, size_px]
    source = helper.make_tensor_value_info("input.1", TensorProto.FLOAT, shape)
    target = helper.make_tensor_value_info("1959", TensorProto.FLOAT, [1, 1, *shape[2:]])
    return _content(nodes, source, target, {}, {}, shape=[1, 1, only_px, only_px])


def _content(
    nodes: list[onnx.NodeProto],
    source: onnx.ValueInfoProto,
    target: onnx.ValueInfoProto,
    constants: dict[str, float],
    metadata: dict[str, str],
    shape: list[int] | None = None,
) -> bytes:
    values = [
        helper.make_tensor(name, TensorProto.FLOAT, [1], np.array([value], np.float32))
        for name, value in constants.items()
    ]
    values.append(helper.make_tensor("axes", TensorProto.INT64, [1], [1]))
    values.append(helper.make_tensor("only_shape", TensorProto.INT64, [4], shape or [1] * 4))
    graph = helper.make_graph(nodes, "for the tests", [source], [target], initializer=values)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    helper.set_model_props(model, metadata)
    return model.SerializeToString()


class OnGpu:
    """A session that claims to run on a GPU, with little memory."""

    def __init__(self, session: InferenceSession, n_runs: int) -> None:
        self.n_runs = n_runs
        self.get_inputs, self.get_outputs = session.get_inputs, session.get_outputs
        self.get_modelmeta = session.get_modelmeta
        self.session = session

    def get_providers(self) -> Sequence[str]:
        return [GPU, CPU]

    def run(self, output_names: Sequence[str], feed: Mapping[str, Singles]) -> Sequence[Singles]:
        self.n_runs -= 1
        if self.n_runs < 0:
            raise runtime_errors.RuntimeException("Failed to allocate memory\n for requested buffer")
        return self.session.run(output_names, feed)


def start_on_gpu(*, n_runs: int) -> StartSession:
    """How to start sessions of which those on the GPU run out of memory after so many runs."""

    def start(model: bytes, providers: Sequence[str]) -> InferenceSession:
        session = start_session(model, (CPU,))
        return OnGpu(session, n_runs) if providers[0] == GPU else session

    return start
