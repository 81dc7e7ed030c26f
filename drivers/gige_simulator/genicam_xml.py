"""Make the GenICam XML of a camera from its features."""

import io
import zipfile
from collections.abc import Iterator, Mapping
from xml.sax.saxutils import quoteattr

from drivers.gige_simulator.features import CHUNKS, Feature
from drivers.gige_simulator.registers import Registers

_HEAD = (
    '<?xml version="1.0" encoding="utf-8"?>'
    "<RegisterDescription ModelName={model} VendorName={vendor} "
    'ToolTip="simulated camera" StandardNameSpace="GEV" '
    'SchemaMajorVersion="1" SchemaMinorVersion="1" SchemaSubMinorVersion="0" '
    'MajorVersion="1" MinorVersion="0" SubMinorVersion="0" ProductGuid="stonefall" VersionGuid="stonefall" '
    'xmlns="http://www.genicam.org/GenApi/Version_1_1">'
)


def genicam_xml(registers: Registers, *, vendor: str, model: str) -> bytes:
    """Return the XML that describes all features, with their registers, limits and selectors."""
    categories: dict[str, list[str]] = {}
    nodes: list[str] = []
    for feature in registers.features.values():
        categories.setdefault(feature.category, []).append(feature.name)
        nodes.extend(_nodes(feature, registers))
    for name, chunk_id in CHUNKS.items():
        categories["ChunkDataControl"].append(f"Chunk{name}")
        nodes.append(_chunk(name, chunk_id))
    return (
        _HEAD.format(model=quoteattr(model), vendor=quoteattr(vendor))
        + "".join(_tree(categories))
        + "".join(nodes)
        + '<Port Name="Device"/></RegisterDescription>'
    ).encode()


def zipped(xml: bytes, name: str) -> bytes:
    """Return a ZIP archive with the XML as a file `name`, the form in which most cameras carry it."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(zipfile.ZipInfo(name), xml, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def _tree(categories: Mapping[str, list[str]]) -> Iterator[str]:
    for category, names in {"Root": list(categories), **categories}.items():
        yield f'<Category Name="{category}">'
        yield "".join(f"<pFeature>{name}</pFeature>" for name in names)
        yield "</Category>"


def _nodes(feature: Feature, registers: Registers) -> Iterator[str]:
    """Yield the node of a feature and that of its register."""
    common = "<pIsLocked>TLParamsLocked</pIsLocked>" if feature.is_locked else ""
    common += f"<Unit>{feature.unit}</Unit>" if feature.unit else ""
    common += "".join(
        f"<pSelected>{other.name}</pSelected>"
        for other in registers.features.values()
        if other.selector == feature.key
    )
    name, value = feature.name, f"<pValue>{feature.name}Reg</pValue>"
    bounds = f"<Min>{feature.minimum:g}</Min><Max>{feature.maximum:g}</Max>"
    if feature.bounds:
        least, greatest = (registers.features[key].name for key in feature.bounds)
        bounds = f"<pMin>{least}</pMin><pMax>{greatest}</pMax>"
    if feature.kind == "string":
        yield _register(feature, registers, kind="StringReg", name=name)
        return
    yield _register(feature, registers, kind=_register_kind(feature), name=f"{name}Reg")
    match feature.kind:
        case "command":
            yield f'<Command Name="{name}">{common}{value}<CommandValue>1</CommandValue></Command>'
        case "boolean":
            yield (
                f'<Boolean Name="{name}">{common}{value}<OnValue>1</OnValue><OffValue>0</OffValue></Boolean>'
            )
        case "enumeration":
            entries = "".join(
                f'<EnumEntry Name="{entry}"><Value>{number}</Value></EnumEntry>'
                for entry, number in feature.entries.items()
            )
            yield f'<Enumeration Name="{name}">{common}{entries}{value}</Enumeration>'
        case "float":
            yield f'<Float Name="{name}">{common}{value}{bounds}</Float>'
        case "scaled":
            yield (
                f'<Float Name="{name}">{common}<pValue>{name}Converted</pValue>{bounds}</Float>'
                f'<Converter Name="{name}Converted"><FormulaTo>FROM / {feature.scale}</FormulaTo>'
                f"<FormulaFrom>TO * {feature.scale}</FormulaFrom><pValue>{name}Reg</pValue></Converter>"
            )
        case "integer":
            yield _integer(feature, registers, common + value)


def _integer(feature: Feature, registers: Registers, common: str) -> str:
    minimum, maximum = (
        round(bound if feature.scale == 1 else bound / feature.scale)  # 64 bit do not survive a division
        for bound in (feature.minimum, feature.maximum)
    )
    maximum_node = f"<Max>{maximum}</Max>"
    limit = ""
    if feature.limit:
        whole, part = (registers.features[key].name for key in feature.limit)
        maximum_node = f"<pMax>{feature.name}Limit</pMax>"
        limit = (
            f'<IntSwissKnife Name="{feature.name}Limit"><pVariable Name="WHOLE">{whole}</pVariable>'
            f'<pVariable Name="PART">{part}</pVariable><Formula>WHOLE - PART</Formula></IntSwissKnife>'
        )
    return (
        f'<Integer Name="{feature.name}">{common}<Min>{minimum}</Min>{maximum_node}'
        f"<Inc>{feature.increment}</Inc></Integer>{limit}"
    )


def _register_kind(feature: Feature) -> str:
    if feature.kind == "float":
        return "FloatReg"
    return "IntReg" if feature.bits == (0, 31) else "MaskedIntReg"


def _register(feature: Feature, registers: Registers, *, kind: str, name: str) -> str:
    index = ""
    if feature.selector:
        selector = registers.features[feature.selector].name
        step = feature.length  # banks lie one after the other
        index = f'<pIndex Offset="{step}">{selector}Reg</pIndex>'
    number = ""
    if kind != "StringReg":
        sign = "Signed" if feature.minimum < 0 else "Unsigned"
        number = "<Endianess>BigEndian</Endianess>"
        if kind != "FloatReg":
            number = f"<Sign>{sign}</Sign>{number}"
        if kind == "MaskedIntReg":
            msb, lsb = feature.bits
            number = f"<LSB>{lsb}</LSB><MSB>{msb}</MSB>{number}"
    return (
        f'<{kind} Name="{name}"><Address>0x{registers.address(feature.key):x}</Address>{index}'
        f"<Length>{feature.length}</Length><AccessMode>{feature.access}</AccessMode><pPort>Device</pPort>"
        f"<Cachable>NoCache</Cachable>{number}</{kind}>"
    )


def _chunk(name: str, chunk_id: int) -> str:
    node, register = ("Float", "FloatReg") if name == "ExposureTime" else ("Integer", "IntReg")
    sign = "<Sign>Unsigned</Sign>" if register == "IntReg" else ""
    return (
        f'<{node} Name="Chunk{name}"><pValue>Chunk{name}Reg</pValue></{node}>'
        f'<{register} Name="Chunk{name}Reg"><Address>0</Address><Length>8</Length>'
        f"<AccessMode>RO</AccessMode><pPort>Chunk{name}Port</pPort>{sign}"
        f"<Endianess>BigEndian</Endianess></{register}>"
        f'<Port Name="Chunk{name}Port"><ChunkID>{chunk_id:x}</ChunkID></Port>'
    )
