"""The languages of reports and alarms."""

from enum import StrEnum


class Language(StrEnum):
    """Language of what people read, as browsers name it."""

    ENGLISH = "en"
    GERMAN = "de"
