"""Twins of cameras and gate that inject faults, for tests and demonstrations."""
