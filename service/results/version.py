"""The version of the algorithm, which every result names."""

ALGORITHM_VERSION = "18"
"""Version of the algorithm, raised by every change that may change a result; `CHANGES` gets a row for each."""
CHANGES = "service/remeasuring/README.md"
"""Guide that says what each version of the algorithm changed in results."""
SAME_BY_DEFAULT = (ALGORITHM_VERSION,)
"""Versions whose results by default settings are those of today, bit for bit: their measured figures hold."""
