"""The network in blocks computes what the original one does."""

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from pipeline.segmentation.network import start_session
from pipeline.training.space_to_depth import to_space_to_depth

SIZE_PX = 32


def exported(rng: np.random.Generator) -> onnx.ModelProto:
    """Return the upper levels of a `BodyNetwork`, as PyTorch exports them, with random weights."""
    weights = {}

    def convolution(source: str, target: str, n_in: int, n_out: int, size: int = 3, stride: int = 1):
        kernel = rng.normal(0, (n_in * size**2) ** -0.5, (n_out, n_in, size, size))
        weights.update({f"{target}.weight": kernel, f"{target}.bias": rng.normal(0, 0.1, n_out)})
        return helper.make_node(
            "Conv",
            [source, f"{target}.weight", f"{target}.bias"],
            [target],
            kernel_shape=[size] * 2,
            strides=[stride] * 2,
            pads=[size // 2] * 4,
        )

    scales = numpy_helper.from_array(np.array([1, 1, 2, 2], np.float32))
    nodes = [
        convolution("view", "stem", 2, 8, stride=2),
        helper.make_node("Relu", ["stem"], ["half"]),
        convolution("half", "down", 8, 16, stride=2),
        helper.make_node("Relu", ["down"], ["quarter"]),
        convolution("quarter", "to_half", 16, 8, size=1),
        helper.make_node("Constant", [], ["scales"], value=scales),
        helper.make_node(
            "Resize",
            ["to_half", "", "scales"],
            ["doubled"],
            mode="nearest",
            coordinate_transformation_mode="asymmetric",
            nearest_mode="floor",
        ),
        helper.make_node("Add", ["half", "doubled"], ["sum"]),
        convolution("sum", "up", 8, 8),
        helper.make_node("Relu", ["up"], ["fine"]),
        convolution("fine", "out", 8, 4, size=1),
        helper.make_node("DepthToSpace", ["out"], ["logits"], blocksize=2, mode="CRD"),
        helper.make_node("Sigmoid", ["logits"], ["body"]),
    ]
    view, body = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, n_channels, SIZE_PX, SIZE_PX])
        for name, n_channels in (("view", 2), ("body", 1))
    )
    graph = helper.make_graph(
        nodes,
        "for the test",
        [view],
        [body],
        [numpy_helper.from_array(weight.astype(np.float32), name) for name, weight in weights.items()],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


@pytest.mark.parametrize("seed", range(3))
def test_blocks_change_no_result(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = exported(rng)
    plain, blocks = (
        start_session(each.SerializeToString(), []) for each in (model, to_space_to_depth(model))
    )
    view = rng.uniform(0, 2, (1, 2, SIZE_PX, SIZE_PX)).astype(np.float32)
    (expected,), (found,) = (session.run(["body"], {"view": view}) for session in (plain, blocks))
    assert expected.std() > 0.01
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_the_size_is_open_and_the_deep_layers_are_kept() -> None:
    model = exported(np.random.default_rng(0))
    blocks = to_space_to_depth(model)
    session = start_session(blocks.SerializeToString(), [])
    assert session.get_inputs()[0].shape == [1, 2, "height", "width"]
    (found,) = session.run(["body"], {"view": np.ones((1, 2, 16, 48), np.float32)})
    assert found.shape == (1, 1, 16, 48)
    shapes = {each.name: list(each.dims) for each in blocks.graph.initializer}
    assert shapes["stem.weight"] == [32, 2, 5, 5]
    assert shapes["down.weight"] == [16, 32, 2, 2]
    assert shapes["out.weight"] == [16, 32, 1, 1]
    assert "Resize" not in {node.op_type for node in blocks.graph.node}
