"""The bootstrap registers of a simulated camera after power-on: addresses, capabilities, and how it names itself."""

import struct
import zlib
from ipaddress import IPv4Address

from drivers.gige_simulator.design import CameraDesign
from drivers.gige_simulator.registers import STREAM_SOURCE_PORT, XML_ADDRESS, Registers

VENDOR = "Stonefall"
VERSION = "simulated 1"

_XML_URL = 0x200
_RESEND = 1 << 2
_CAPABILITIES = 1 << 31 | 1 << 30 | 1 << 28 | 1 << 19 | 1 << 17 | 1 << 6 | 1 << 5 | 1 << 1 | 1
"""User name, serial, link speed, PTP, scheduled action, action, pending ack, write memory, concatenation."""


def put_bootstrap(registers: Registers, design: CameraDesign, stream_port: int) -> None:
    """Set the registers that say which device this is, where its XML lies, and what it can do."""
    ways, mac = design.ways, mac_address(design.serial)
    words = {
        0x000: 0x00020000,  # the standard's version
        0x004: 0x80000001 if ways.encoding == "utf-8" else 0x80000000,  # big endian, UTF-8
        0x008: int.from_bytes(mac[:2], "big"),
        0x00C: int.from_bytes(mac[2:], "big"),
        0x010: 0x7,  # link-local, DHCP, persistent
        0x014: 0x6,
        0x024: int(IPv4Address(design.address)),
        0x034: 0xFF000000,
        0x600: 1,  # network interfaces
        0x670: 1000,  # link speed in Mbit/s
        0x904: 1,  # stream channels
        0x908: 1,  # action signals
        0x934: _CAPABILITIES | (_RESEND if design.can_resend else 0),
        0x940: 1_000_000_000,  # ticks a second
        STREAM_SOURCE_PORT: stream_port,
    }
    for address, word in words.items():
        registers.put_word(address, word)
    name, suffix = ways.model.replace(" ", "_"), "zip" if design.is_xml_zipped else "xml"
    registers.put_text(_XML_URL, f"Local:{name}.{suffix};{XML_ADDRESS:x};{len(registers.xml):x}")
    resembled = f"as of {ways.resembles}" if ways.resembles else f"{ways.dialect} dialect"
    registers.put("DeviceVendorName", VENDOR)
    registers.put("DeviceModelName", ways.model)
    registers.put("DeviceVersion", VERSION)
    registers.put("DeviceManufacturerInfo", resembled)
    registers.put("DeviceSerialNumber", design.serial)


def mac_address(serial: str) -> bytes:
    """Return the MAC address of a device, locally administered, derived from its serial number."""
    return b"\x02\x5f" + struct.pack(">I", zlib.crc32(serial.encode()))
