"""The level of the log, which configuration and command line name."""

from enum import StrEnum


class LogLevel(StrEnum):
    """Least level of the lines that are logged; `debug` has each stone from the gate to its result."""

    DEBUG = "debug"
    INFO = "info"
    WARNING = "warning"
    ERROR = "error"
