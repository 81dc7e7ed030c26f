"""Reasons why the store cannot be written or read, from the errors of SQLite and of the file system."""

import errno
import json
import sqlite3
from dataclasses import dataclass
from enum import StrEnum

from service.base.messages import Code, CodedText, message


class TroubleCause(StrEnum):
    """What is wrong with the disk or with the database."""

    FULL = "full"
    LOCKED = "locked"
    UNWRITABLE = "unwritable"
    DISK = "disk"
    DAMAGED = "damaged"
    """The content of the database is not to be trusted any more; all other causes pass by themselves."""


CAUSES_OF_SQLITE = {
    sqlite3.SQLITE_PERM: TroubleCause.UNWRITABLE,
    sqlite3.SQLITE_BUSY: TroubleCause.LOCKED,
    sqlite3.SQLITE_LOCKED: TroubleCause.LOCKED,
    sqlite3.SQLITE_READONLY: TroubleCause.UNWRITABLE,
    sqlite3.SQLITE_IOERR: TroubleCause.DISK,
    sqlite3.SQLITE_CORRUPT: TroubleCause.DAMAGED,
    sqlite3.SQLITE_FULL: TroubleCause.FULL,
    sqlite3.SQLITE_CANTOPEN: TroubleCause.UNWRITABLE,
    sqlite3.SQLITE_PROTOCOL: TroubleCause.LOCKED,
    sqlite3.SQLITE_NOTADB: TroubleCause.DAMAGED,
}
"""By the primary code of the error; any other code is a fault of the program."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
UNWRITABLE = (errno.EROFS, errno.EACCES, errno.EPERM, errno.ENOTDIR, errno.EEXIST, errno.ENOENT)


@dataclass(frozen=True, slots=True)
class StoreTrouble:
    """Why the store cannot be used now, and what to do."""

    cause: TroubleCause
    detail: str

    def __str__(self) -> str:
        return self.said

    @property
    def said(self) -> CodedText:
        """The trouble in words, with its remedy."""
        return message(Code(f"store_{self.cause}"), reported=self.detail)


def trouble_of(error: Exception) -> StoreTrouble | None:
    """Return the trouble that an error shows; None for an error that is not the disk's or the database file's."""
    match error:
        case sqlite3.Error():
            return _trouble_of_sqlite(error)
        case OSError():
            cause = TroubleCause.FULL if error.errno in FULL else TroubleCause.DISK
            if error.errno in UNWRITABLE:
                cause = TroubleCause.UNWRITABLE
            return StoreTrouble(cause, f"cannot be written: {error.strerror}")
        case json.JSONDecodeError() | UnicodeDecodeError():
            return StoreTrouble(TroubleCause.DAMAGED, "a record is damaged")
    return None


def _trouble_of_sqlite(error: sqlite3.Error) -> StoreTrouble | None:
    code: int | None = getattr(error, "sqlite_errorcode", None)
    if code is None:  # not of SQLite: Python could not decode a text
        is_text = isinstance(error, sqlite3.OperationalError) and "decode" in str(error)
        return StoreTrouble(TroubleCause.DAMAGED, "a text is damaged") if is_text else None
    # all documents are made by `json.dumps`
    if code == sqlite3.SQLITE_ERROR and str(error) == "malformed JSON":
        return StoreTrouble(TroubleCause.DAMAGED, "a record is damaged")
    cause = CAUSES_OF_SQLITE.get(code & 0xFF)
    return None if cause is None else StoreTrouble(cause, str(error))
