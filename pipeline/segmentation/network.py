"""A segmentation network in an ONNX file: loading and checking it, and P(body) of every pixel.

Two kinds are distinguished by the file's metadata: our own (`FORMAT`), which sees the image and the view expected
without the body, and any of the shape of a U2-Net, which sees the image alone. A file that leaves height and width
open computes on whatever size it is given, so small bodies cost less.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol

import cv2
import numpy as np

from pipeline.arrays import FloatImage, Singles
from pipeline.errors import ModelError
from pipeline.formats import unread_format
from pipeline.segmentation.onnx_runtime import onnxruntime, runtime_errors
from pipeline.segmentation.u2net import PUBLISHED_SIZE_PX, saliency, u2net_input

FORMAT = "stonefall-network/1"
"""Value of `format` in the metadata of our own networks."""
SIZE_PX = "size_px"
"""Key in the metadata: edge of the largest square that a network of open size was trained for."""
STEP_PX = 16
"""Height and width of a network of open size are multiples of this: it halves its resolution four times."""
CPU = "CPUExecutionProvider"
AUTOMATIC_PROVIDERS = ("CUDAExecutionProvider", CPU)
"""Tried in this order where nothing is configured. Not TensorRT, which builds its engine for minutes at each start."""
PROVIDER_OPTIONS: Mapping[str, Mapping[str, str]] = {
    "CUDAExecutionProvider": {
        "use_tf32": "0",  # ten bits of mantissa are another network
        "cudnn_conv_algo_search": "HEURISTIC",  # trying all of them takes long, for every new size of a view
    }
}
MAX_RELATIVE = np.float32(2.0)
"""Brightest input of our network, as a share of the wall; brighter pixels are clipped."""
RUNTIME_ERRORS = (
    runtime_errors.EPFail,
    runtime_errors.EngineError,
    runtime_errors.Fail,
    runtime_errors.InvalidArgument,
    runtime_errors.InvalidGraph,
    runtime_errors.InvalidProtobuf,
    runtime_errors.NoModel,
    runtime_errors.NotImplemented,
    runtime_errors.RuntimeException,
    RuntimeError,
    ValueError,
)
"""What onnxruntime raises for a model, a provider or a run; these have no common base class."""


class NetworkKind(StrEnum):
    """Kind of a network, by its inputs and outputs."""

    OURS = "stonefall"
    U2NET = "u2net"


class InferenceSession(Protocol):
    """The part of an `onnxruntime.InferenceSession` that is used."""

    def get_inputs(self) -> Sequence[Any]: ...
    def get_outputs(self) -> Sequence[Any]: ...
    def get_modelmeta(self) -> Any: ...
    def get_providers(self) -> Sequence[str]: ...
    def run(self, output_names: Sequence[str], feed: Mapping[str, Singles]) -> Sequence[Singles]: ...


StartSession = Callable[[bytes, Sequence[str]], InferenceSession]


def start_session(model: bytes, providers: Sequence[str]) -> InferenceSession:
    """Start a session that computes the same on every run: one thread, one operation after the other."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    options.log_severity_level = 4  # fatal: everything else is raised, and reported where it is caught
    wanted = [(name, dict(PROVIDER_OPTIONS.get(name, {}))) for name in providers]
    # onnxruntime's own fallback only prints to stdout
    session: InferenceSession = onnxruntime.InferenceSession(
        model, options, providers=wanted, enable_fallback=0
    )
    return session


@dataclass(slots=True, kw_only=True, eq=False)
class Network:
    """A loaded network, for any number of threads."""

    name: str
    sha256: str
    kind: NetworkKind
    size_px: int
    """Edge of the largest square it computes on."""
    step_px: int
    """Step of the heights and widths it computes on."""
    metadata: Mapping[str, str]
    fallback: str | None
    """Why it does not run on the provider that was asked for, for people; `None` if it does."""
    _model: bytes = field(repr=False)
    _session: InferenceSession = field(repr=False)
    _start: StartSession = field(repr=False)

    @property
    def provider(self) -> str:
        """The execution provider of onnxruntime that it runs on."""
        return self._session.get_providers()[0]

    def probability(self, view: Singles) -> FloatImage:
        """Compute P(body) (h, w) of a region.

        A U2-Net sees the region squeezed into its square, as published. Its result is relative: its greatest value
        is 1 even in an empty image.

        Parameters
        ----------
        view
            (2, h, w) image, and the view expected without the body (0 where it is not known), as shares of the plain
            wall's grey level and no more than `MAX_RELATIVE`. A U2-Net takes the image alone, of any size.

        Raises
        ------
        ModelError
            The network cannot compute, not even on the CPU.
        """
        if self.kind is NetworkKind.OURS:
            return self._run(view[None])
        height, width = view.shape[1:]
        squeezed = _resized(view[0], (self.size_px, self.size_px))
        return _resized(saliency(self._run(u2net_input(squeezed))), (width, height))

    def _run(self, view: Singles) -> FloatImage:
        """Return the first output (h, w) for an input (1, channels, h, w), by the CPU when a provider fails."""
        session = self._session
        source, target = session.get_inputs()[0].name, session.get_outputs()[0].name
        try:
            found = session.run([target], {source: view})
        except RUNTIME_ERRORS as err:
            provider = session.get_providers()[0]
            if provider == CPU:
                raise ModelError(f"model {self.name}: cannot be run: {_line(err)}") from err
            self.fallback = f"{provider} failed, the CPU computes: {_line(err)}"
            self._session = self._start(self._model, (CPU,))
            return self._run(view)
        return np.asarray(found[0][0, 0], np.float32)


def load_network(
    model: bytes, providers: Sequence[str] = (CPU,), *, start: StartSession = start_session
) -> Network:
    """Load the content of an ONNX file on the first of these providers that works, else on the CPU.

    Raises
    ------
    ModelError
        It is no ONNX model, or none of the two kinds; says what was expected and what was found.
    """
    sha256 = hashlib.sha256(model).hexdigest()
    session, fallback = _first_session(model, providers, start)
    metadata = dict(session.get_modelmeta().custom_metadata_map)
    kind = NetworkKind.OURS if "format" in metadata else NetworkKind.U2NET
    if kind is NetworkKind.OURS and metadata["format"] != FORMAT:
        raise ModelError(
            f"model {sha256[:8]}: the format in its metadata {unread_format(metadata['format'], FORMAT)};"
            " use a model trained for this version"
        )
    size_px, step_px = _sizes_px(session, kind, metadata, sha256)
    return Network(
        name=f"{kind}-{sha256[:8]}",
        sha256=sha256,
        kind=kind,
        size_px=size_px,
        step_px=step_px,
        metadata=metadata,
        fallback=fallback,
        _model=model,
        _session=session,
        _start=start,
    )


def available_providers() -> tuple[str, ...]:
    """Return those of `AUTOMATIC_PROVIDERS` that this machine's onnxruntime was built with."""
    built_in = onnxruntime.get_available_providers()
    return tuple(name for name in AUTOMATIC_PROVIDERS if name in built_in)


def _first_session(
    model: bytes, providers: Sequence[str], start: StartSession
) -> tuple[InferenceSession, str | None]:
    """Start a session; return it, and why it is not on the first of the providers."""
    built_in = onnxruntime.get_available_providers()
    problems = []
    for name in providers:
        if name == CPU:
            break
        if name not in built_in and start is start_session:
            problems.append(f"this onnxruntime has no {name}")
            continue
        try:
            session = start(model, (name, CPU))
        except RUNTIME_ERRORS as err:
            problems.append(f"{name} failed: {_line(err)}")
            continue
        if session.get_providers()[0] == name:  # missing libraries are not raised
            return session, "; ".join(problems) or None
        problems.append(f"{name} did not start")
    try:
        session = start(model, (CPU,))
    except RUNTIME_ERRORS as err:
        if isinstance(err, runtime_errors.NotImplemented) or "version" in str(err):
            raise ModelError(
                f"is beyond onnxruntime {onnxruntime.__version__}, export it with an older opset: {_line(err)}"
            ) from err
        raise ModelError(
            f"expected an ONNX model, found {len(model)} bytes that are not one: {_line(err)}"
        ) from err
    return session, f"{', '.join(problems)}, the CPU computes" if problems else None


def _sizes_px(
    session: InferenceSession, kind: NetworkKind, metadata: Mapping[str, str], sha256: str
) -> tuple[int, int]:
    """Return the largest edge of the input and the step of smaller ones; `ModelError` if they do not fit the kind."""
    inputs, outputs = session.get_inputs(), session.get_outputs()
    channels, expected = (
        (2, f'one input 1x2xNxN ("view"; N open only with {SIZE_PX} in the metadata), one output 1x1xNxN')
        if kind is NetworkKind.OURS
        else (3, "a U2-Net: one input 1x3xNxN, first output 1x1xNxN")
    )
    shapes = [list(inputs[0].shape), list(outputs[0].shape)] if len(inputs) == 1 and outputs else []
    if [len(shape) for shape in shapes] == [4, 4] and _fits(shapes[0], channels) and _fits(shapes[1], 1):
        size = shapes[0][2]
        if isinstance(size, int):
            return size, size
        if kind is NetworkKind.U2NET:
            return PUBLISHED_SIZE_PX, PUBLISHED_SIZE_PX
        if metadata.get(SIZE_PX, "").isdigit():
            return int(metadata[SIZE_PX]), STEP_PX
    found = [f"{part.name} {'x'.join(map(str, part.shape))}" for part in (*inputs, *outputs[:1])]
    raise ModelError(f"model {sha256[:8]}: expected {expected}; found {', '.join(found) or 'nothing'}")


def _fits(shape: Sequence[int | str | None], channels: int) -> bool:
    """True when a shape may be 1 x channels x N x N; a dimension that is left open is no number."""
    batch, found, height, width = shape
    return (not isinstance(batch, int) or batch == 1) and found == channels and _same(height, width)


def _same(height: int | str | None, width: int | str | None) -> bool:
    return height == width or not (isinstance(height, int) or isinstance(width, int))


def _resized(values: FloatImage, size_px: tuple[int, int]) -> FloatImage:
    """Return values resized to (width, height): by area averaging where they shrink, linearly where they grow."""
    height, width = values.shape
    if (width, height) == size_px:
        return values
    shrinks = width >= size_px[0] and height >= size_px[1]
    return np.asarray(
        cv2.resize(values, size_px, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    )


def _line(err: Exception) -> str:
    return " ".join(str(err).split())[:300]
