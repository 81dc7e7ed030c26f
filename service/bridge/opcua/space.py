"""Building of the address space: nodes with identifiers that are texts, so that they are the same after any change."""

from collections.abc import Mapping
from typing import Any

from asyncua import Server, ua
from asyncua.ua import ObjectIds as Ids

NAMESPACE = "urn:stonefall:opcua"
INDEX = 2
"""Place of the namespace at the server, the first after the application's own; clients should look it up by its URI."""

UNITS: Mapping[str, tuple[str, str, str]] = {
    "mm": ("MMT", "mm", "millimetre"),
    "mm3": ("MMQ", "mm³", "cubic millimetre"),
    "percent": ("P1", "%", "percent"),
    "g": ("GRM", "g", "gram"),
    "per_min": ("C94", "min⁻¹", "reciprocal minute"),
}
"""Unit at the end of a name -> its code of UNECE Recommendation 20, symbol and name."""


def node_id(path: str) -> ua.NodeId:
    """Return the identifier of a node by its path."""
    return ua.NodeId(path, INDEX)


def engineering_units(unit: str) -> ua.EUInformation:
    """Return a unit as OPC 10000-8 has it; its id is made of the characters of its UNECE code."""
    code, symbol, name = UNITS[unit]
    return ua.EUInformation(
        NamespaceUri="http://www.opcfoundation.org/UA/units/un/cefact",
        UnitId=int.from_bytes(code.encode()),
        DisplayName=ua.LocalizedText(symbol),
        Description=ua.LocalizedText(name),
    )


CLASSES = {
    ua.ObjectAttributes: ua.NodeClass.Object,
    ua.VariableAttributes: ua.NodeClass.Variable,
    ua.ObjectTypeAttributes: ua.NodeClass.ObjectType,
    ua.MethodAttributes: ua.NodeClass.Method,
}
STANDARD = ("CurrentState", "Id", "Number")
"""Names of OPC UA's own state machines, in its namespace."""


class Space:
    """The address space of a server, to which nodes are added."""

    def __init__(self, server: Server) -> None:
        self._session = server.iserver.isession

    async def add_object(
        self,
        path: str,
        meaning: str,
        kind: int = Ids.BaseObjectType,
        parent: ua.NodeId | None = None,
        reference: int = Ids.HasComponent,
    ) -> None:
        """Add an object below the one whose path is a part of its own, or below `parent`."""
        attributes = ua.ObjectAttributes(EventNotifier=0)
        await self._add(path, attributes, meaning, kind, parent, reference)

    async def add_variable(
        self, path: str, meaning: str, data_type: int, *, is_list: bool = False, kind: int
    ) -> None:
        """Add a read-only variable without a value."""
        attributes = _variable(ua.Variant(None), data_type, is_list=is_list)
        is_property = kind == Ids.PropertyType
        name = path.rpartition(".")[2]
        await self._add(
            path, attributes, meaning, kind, None,
            Ids.HasProperty if is_property else Ids.HasComponent, index=0 if name in STANDARD else INDEX,
        )  # fmt: skip

    async def add_property(self, path: str, value: ua.Variant, data_type: int) -> None:
        """Add a property of OPC UA itself, the last part of the path, to a node."""
        attributes = _variable(value, data_type, is_list=isinstance(value.Value, list))
        await self._add(path, attributes, "", Ids.PropertyType, None, Ids.HasProperty, index=0)

    async def add_event_type(
        self, path: str, meaning: str, fields: Mapping[str, ua.VariantType], base: int
    ) -> None:
        """Add a type of event with its fields."""
        await self._add(
            path, ua.ObjectTypeAttributes(IsAbstract=False), meaning, None,
            ua.NodeId(base), Ids.HasSubtype,
        )  # fmt: skip
        for name, kind in fields.items():
            attributes = _variable(ua.Variant(None), kind.value, is_list=False)
            await self._add(
                f"{path}.{name}", attributes, "", Ids.PropertyType, None,
                Ids.HasProperty,
            )  # fmt: skip

    async def add_method(
        self, path: str, meaning: str, inputs: Mapping[str, Any], outputs: Mapping[str, Any]
    ) -> None:
        """Add a method; its arguments are types by name, in a list of one for a list."""
        attributes = ua.MethodAttributes(Executable=True, UserExecutable=True)
        await self._add(path, attributes, meaning, None, None, Ids.HasComponent)
        for name, arguments in (("InputArguments", inputs), ("OutputArguments", outputs)):
            if arguments:
                described = ua.Variant([_argument(*each) for each in arguments.items()])
                await self.add_property(f"{path}.{name}", described, Ids.Argument)

    async def refer(self, source: ua.NodeId, target: ua.NodeId, reference: int) -> None:
        """Add a reference between nodes."""
        item = ua.AddReferencesItem(
            SourceNodeId=source, TargetNodeId=target, ReferenceTypeId=ua.NodeId(reference), IsForward=True
        )
        for status in await self._session.add_references([item]):
            status.check()

    async def _add(
        self,
        path: str,
        attributes: Any,
        meaning: str,
        kind: int | None,
        parent: ua.NodeId | None,
        reference: int,
        index: int = INDEX,
    ) -> None:
        above, _, name = path.rpartition(".")
        attributes.DisplayName = ua.LocalizedText(name)
        attributes.Description = ua.LocalizedText(meaning)
        item = ua.AddNodesItem(
            RequestedNewNodeId=node_id(path),
            BrowseName=ua.QualifiedName(name, index),
            NodeClass=CLASSES[type(attributes)],
            ParentNodeId=node_id(above) if parent is None else parent,
            ReferenceTypeId=ua.NodeId(reference),
            TypeDefinition=ua.NodeId() if kind is None else ua.NodeId(kind),
            NodeAttributes=attributes,
        )
        for result in await self._session.add_nodes([item]):
            result.StatusCode.check()


def _variable(value: ua.Variant, data_type: int, *, is_list: bool) -> ua.VariableAttributes:
    return ua.VariableAttributes(
        Value=value,
        DataType=ua.NodeId(data_type),
        ValueRank=ua.ValueRank.OneDimension if is_list else ua.ValueRank.Scalar,
        AccessLevel=ua.AccessLevel.CurrentRead.mask,
        UserAccessLevel=ua.AccessLevel.CurrentRead.mask,
        Historizing=False,
    )


def _argument(name: str, kind: Any) -> ua.Argument:
    is_list = isinstance(kind, list)
    return ua.Argument(
        Name=name,
        DataType=ua.NodeId((kind[0] if is_list else kind).value),
        ValueRank=ua.ValueRank.OneDimension if is_list else ua.ValueRank.Scalar,
        ArrayDimensions=[],
        Description=ua.LocalizedText(name),
    )
