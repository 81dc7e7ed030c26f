"""Methods of the server: a table of them, and the checks that each call passes before it is carried out."""

import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from asyncua import ua
from asyncua.crypto.permission_rules import User

from service.bridge.opcua.space import Space, node_id

log = logging.getLogger(__name__)

Types = Mapping[str, Any]
"""Type by the name of an argument, in a list of one for a list."""


@dataclass(frozen=True, slots=True)
class Caller:
    """Who calls: the user, where from, and which subscriptions are its own."""

    user: User
    address: str
    owns: Callable[[int], bool]


@dataclass(frozen=True, slots=True)
class ServedMethod:
    """A method: `run` gets who calls, the object, and the arguments; it returns outputs, or a status."""

    run: Callable[..., Awaitable[Sequence[object] | ua.StatusCode]]
    inputs: Types
    outputs: Types
    path: str = ""
    """Below the root of the address space; empty: a method of OPC UA itself, whose node is there"""
    meaning: str = ""
    standard: int = 0
    """Number of that node"""


class MethodTable:
    """All methods that can be called, by their nodes."""

    def __init__(self) -> None:
        self._methods: dict[ua.NodeId, ServedMethod] = {}

    async def add(self, space: Space, method: ServedMethod) -> None:
        """Add a method to the table, and its node to the address space."""
        if method.path:
            await space.add_method(method.path, method.meaning, method.inputs, method.outputs)
        self._methods[node_id(method.path) if method.path else ua.NodeId(method.standard)] = method

    async def call(self, caller: Caller, request: ua.CallMethodRequest) -> ua.CallMethodResult:
        """Check and carry out a call."""
        result = ua.CallMethodResult()
        method = self._methods.get(request.MethodId)
        if method is None:
            result.StatusCode = ua.StatusCode(ua.StatusCodes.BadMethodInvalid)
            return result
        arguments = list(request.InputArguments or ())
        if len(arguments) != len(method.inputs):
            is_short = len(arguments) < len(method.inputs)
            codes = ua.StatusCodes
            result.StatusCode = ua.StatusCode(
                codes.BadArgumentsMissing if is_short else codes.BadTooManyArguments
            )
            return result
        checked = [
            _is_of(argument, kind) for argument, kind in zip(arguments, method.inputs.values(), strict=True)
        ]
        codes = [ua.StatusCodes.Good if is_good else ua.StatusCodes.BadTypeMismatch for is_good in checked]
        result.InputArgumentResults = [ua.StatusCode(code) for code in codes]
        if not all(checked):
            result.StatusCode = ua.StatusCode(ua.StatusCodes.BadInvalidArgument)
            return result
        outputs = await method.run(caller, request.ObjectId, *(argument.Value for argument in arguments))
        if isinstance(outputs, ua.StatusCode):
            result.StatusCode = outputs
        else:
            result.OutputArguments = [
                ua.Variant(
                    value, kind[0] if isinstance(kind, list) else kind, is_array=isinstance(kind, list)
                )
                for value, kind in zip(outputs, method.outputs.values(), strict=True)
            ]
        return result


def _is_of(argument: ua.Variant, kind: ua.VariantType) -> bool:
    if argument.Value is None:
        return kind in (ua.VariantType.String, ua.VariantType.LocalizedText)
    return argument.VariantType == kind and not argument.is_array
