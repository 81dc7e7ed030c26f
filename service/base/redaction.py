"""Show a configuration, or any text, without what must stay secret."""

import re
from collections.abc import Callable, Iterable
from typing import Any

SECRET_NAME = re.compile(
    r"sha256|secret|token|password|passphrase|credential|private|signature", re.IGNORECASE
)
USER_IN_URL = re.compile(r"(?<=://)[^/\s\"]+(?=@)")
"""User and password, which the last `@` before the path ends."""
URL = re.compile(
    r"(?P<host>\b[a-z][a-z0-9+.-]{0,20}://[^\s\"'<>/?#]+)"
    r"(?P<first>/[^\s\"'<>/?#;]*)?(?P<rest>[\"'<>/?#;]\S*)?",  # quotes are part of some, so of all
    re.IGNORECASE,
)
"""Only scheme, host and the first part of the path are shown: what comes after them is a token as often as not."""
REDACTED = "redacted"
SECRET_TEXTS = tuple(
    re.compile(pattern, re.IGNORECASE | re.DOTALL)
    for pattern in (
        r"-----BEGIN [A-Z ]*PRIVATE KEY-----.*?(?:-----END [A-Z ]*PRIVATE KEY-----|\Z)",
        r"\bwhsec_[A-Za-z0-9+/_=-]+",  # of webhooks
        r"\bstonefall_[A-Za-z0-9_-]{43,}",  # tokens of `stonefall keys`; names of metrics are shorter
        r"(?<=\bBearer )[^\s\"',]+",
        r"(?<=\bBasic )[A-Za-z0-9+/=]{6,}",
        r"(?<=[?&])[^\s\"'<>=]{1,256}=[^\s\"'<>]*",  # the query of a path, which may be a token
        r"(?<=sha256)[\"']?\s*[=:]\s*[\"']?[0-9a-f]{64}",
        r"(?:password|passphrase|token|secret)[\"']?\s*[=:]\s*[\"']?[^\s\"',}]+",
    )
)
"""What is secret wherever it stands, such as in a log."""


def redacted(document: Any, clean: Callable[[str], str] = str) -> Any:
    """Return a document with the values of all members named like a secret replaced, and URLs as `shown`.

    `clean` is applied to its texts, and to the names of its members.
    """
    match document:
        case dict():
            return {
                clean(name): REDACTED
                if SECRET_NAME.search(name) and value not in (None, "", (), [])
                else redacted(value, clean)
                for name, value in document.items()
            }
        case list() | tuple():
            return [redacted(each, clean) for each in document]
        case str():
            return clean(shown(document))
    return document


def shown(text: str) -> str:
    """Return a text whose URLs have no user, only the first part of their path, and no query."""
    return URL.sub(_shown_url, USER_IN_URL.sub(REDACTED, text))


def scrubbed(text: str, known: Iterable[str] = ()) -> str:
    """Return a text without what looks like a secret, and without those that are known, however they look."""
    for secret in sorted(filter(None, known), key=len, reverse=True):  # one may be a part of another
        text = text.replace(secret, REDACTED)
    for pattern in SECRET_TEXTS:
        text = pattern.sub(REDACTED, text)
    return shown(text)


def _shown_url(url: re.Match[str]) -> str:
    separator, rest = (url["rest"] or "")[:1], (url["rest"] or "")[1:]
    return f"{url['host']}{url['first'] or ''}{separator}{REDACTED if rest else ''}"
