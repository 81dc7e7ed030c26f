"""Devices that a network is fitted on."""

from enum import StrEnum


class Device(StrEnum):
    """A kind of processor, as PyTorch names it."""

    AUTO = "auto"
    """A GPU if PyTorch sees one."""
    CPU = "cpu"
    CUDA = "cuda"
