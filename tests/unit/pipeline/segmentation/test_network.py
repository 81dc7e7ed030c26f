"""ONNX files as networks: which are accepted, which are refused, and where they run."""

from collections.abc import Sequence

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples
from support.networks import GPU, OnGpu, darkness_network, difference_network, start_on_gpu

from pipeline.arrays import Singles
from pipeline.errors import ModelError
from pipeline.segmentation.network import CPU, InferenceSession, load_network, start_session
from pipeline.segmentation.onnx_runtime import runtime_errors
from pipeline.segmentation.u2net import saliency, u2net_input


def _disc(height: int, width: int, radius_px: int) -> Singles:
    """Return a dark disc in the middle before a wall of 1."""
    v, u = np.mgrid[:height, :width]
    inside = np.hypot(u - width / 2, v - height / 2) < radius_px
    return np.where(inside, 0.3, 1.0).astype(np.float32)


def test_our_network_says_where_the_body_is() -> None:
    network = load_network(difference_network())
    assert (network.kind, network.size_px, network.provider) == ("stonefall", 256, CPU)
    assert network.fallback is None
    assert network.name == f"stonefall-{network.sha256[:8]}"
    image = _disc(256, 256, 60)
    for expected in (np.zeros_like(image), np.ones_like(image)):
        body = network.probability(np.stack([image, expected]))
        assert body.shape == image.shape
        assert np.mean((body > 0.5) != (image < 0.5)) < 0.01
    # what is expected there is no body, whatever it looks like
    assert network.probability(np.stack([image, image])).max() < 0.01


def test_a_network_of_open_size_computes_on_what_it_is_given() -> None:
    network = load_network(difference_network("n", size_px="256"))
    assert (network.size_px, network.step_px) == (256, 16)
    image = _disc(96, 128, 30)
    body = network.probability(np.stack([image, np.ones_like(image)]))
    assert np.mean((body > 0.5) != (image < 0.5)) < 0.02
    with pytest.raises(ModelError, match="N open only with size_px in the metadata"):
        load_network(difference_network("n"))


def test_a_u2net_sees_the_image_alone() -> None:
    network = load_network(darkness_network())
    assert (network.kind, network.size_px) == ("u2net", 320)
    image = _disc(1024, 1280, 200)
    body = network.probability(image[None])
    assert body.shape == image.shape
    assert np.mean((body > 0.5) != (image < 0.5)) < 0.01
    np.testing.assert_array_equal(body, network.probability(np.stack([image, image])))


def test_a_u2net_of_any_size_runs_at_the_published_one() -> None:
    assert load_network(darkness_network("n")).size_px == 320
    assert load_network(darkness_network(160)).size_px == 160


@examples(0.2)
@given(st.floats(0.01, 255), st.integers(0, 2**32 - 1))
def test_units_do_not_matter_to_a_u2net(unit: float, seed: int) -> None:
    image = np.random.default_rng(seed).uniform(0.1, 1, (8, 8)).astype(np.float32)
    view = u2net_input(image * np.float32(unit))
    np.testing.assert_allclose(view, u2net_input(image), atol=1e-4)
    assert view.shape == (1, 3, 8, 8)
    assert view.max() == pytest.approx((1 - 0.485) / 0.229, abs=1e-4)
    stretched = saliency(image)
    assert (stretched.min(), stretched.max()) == (0, pytest.approx(1))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "expected an ONNX model, found 0 bytes"),
        (b"no model" * 50, "expected an ONNX model, found 400 bytes"),
        (difference_network()[:300], "expected an ONNX model"),
        (
            difference_network(format="stonefall-network/9"),
            'is "stonefall-network/9", of a later version: update',
        ),
        (darkness_network(channels=1), "expected a U2-Net: one input 1x3xNxN.*found input.1 1x1x320x320"),
    ],
    ids=["empty", "garbage", "cut off", "another version", "one channel"],
)
def test_refused_with_what_was_expected(content: bytes, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        load_network(content)


@pytest.mark.parametrize("change", ["ir", "opset"])
def test_a_model_of_a_later_onnx_is_not_called_no_model(change: str) -> None:
    model = onnx.load_from_string(difference_network())
    if change == "ir":
        model.ir_version = 99
    else:
        model.opset_import[0].version = 99
    with pytest.raises(ModelError, match=r"^is beyond onnxruntime [0-9.]+, export it with an older opset: "):
        load_network(model.SerializeToString())


def test_out_of_memory_at_the_start_goes_on_on_the_cpu() -> None:
    def start(model: bytes, providers: Sequence[str]) -> InferenceSession:
        if providers[0] == GPU:
            raise runtime_errors.RuntimeException("CUDA failure 2: out of memory")
        return start_session(model, providers)

    network = load_network(difference_network(), (GPU, CPU), start=start)
    assert network.provider == CPU
    assert network.fallback == f"{GPU} failed: CUDA failure 2: out of memory, the CPU computes"


def test_out_of_memory_in_a_run_goes_on_on_the_cpu() -> None:
    network = load_network(difference_network(), (GPU,), start=start_on_gpu(n_runs=1))
    view = np.stack([_disc(256, 256, 60)] * 2)
    first = network.probability(view)
    assert (network.provider, network.fallback) == (GPU, None)
    second = network.probability(view)
    np.testing.assert_array_equal(first, second)
    assert network.provider == CPU
    assert network.fallback is not None
    assert network.fallback.startswith(f"{GPU} failed, the CPU computes: Failed to allocate memory for")


def test_a_provider_that_does_not_start_is_told() -> None:
    def start(model: bytes, providers: Sequence[str]) -> InferenceSession:
        return start_session(model, (CPU,))  # as onnxruntime does when libraries are missing

    network = load_network(difference_network(), (GPU,), start=start)
    assert network.fallback == f"{GPU} did not start, the CPU computes"
    network = load_network(difference_network(), ("NoSuchProvider", CPU))
    assert network.fallback == "this onnxruntime has no NoSuchProvider, the CPU computes"


def test_a_cpu_that_cannot_compute_is_an_error() -> None:
    class Broken(OnGpu):
        def get_providers(self) -> Sequence[str]:
            return [CPU]

    network = load_network(
        difference_network(), start=lambda model, names: Broken(start_session(model, names), 0)
    )
    with pytest.raises(ModelError, match=f"model {network.name}: cannot be run: Failed to allocate"):
        network.probability(np.ones((2, 256, 256), np.float32))
