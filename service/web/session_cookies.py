"""The cookie of a session, and the requests that a browser may be made to send with it.

Browsers send cookies with whatever any page asks for, and keep them by the name of the host alone: other ports and, for
`SameSite`, other hosts of the domain count as ours. So what is written with a cookie must come from a page of our very
origin, and over TLS the cookie has a name (`__Host-`) that no other host of the domain can set.
"""

from fastapi import Request, Response

from service.web.problems import Problem
from service.web.sessions import SessionCookie
from service.web.settings import ApiSettings

NAME, NAME_OVER_TLS = "stonefall-session", "__Host-stonefall-session"
PROXY = "a proxy in front of this service must pass on Host and X-Forwarded-Proto"
READING = frozenset({"GET", "HEAD"})


def session_cookie(request: Request) -> str | None:
    """Return the cookie of a session; None without one, and if there are several, of which one is not from us."""
    name = _name(request)
    found = set()
    for pair in ";".join(request.headers.getlist("cookie")).split(";"):
        key, _, value = pair.partition("=")
        if key.strip() == name:
            found.add(value.strip())
    return found.pop() if len(found) == 1 else None


def set_session_cookie(
    request: Request, response: Response, cookie: str, session: SessionCookie, now_s: float
) -> None:
    """Set the cookie of a session, for this host alone and hidden from scripts."""
    _set(request, response, cookie, max(0, session.expires_s - int(now_s)))


def clear_session_cookie(request: Request, response: Response) -> None:
    """Clear the cookie of the session."""
    _set(request, response, "", 0)


def require_own_page(request: Request, settings: ApiSettings) -> None:
    """Reject cross-origin writes that carry the session cookie (CSRF) with the problem 403.

    Reads do no harm: no other origin is allowed to see an answer, and a browser may follow a link. A write needs the
    `Origin` that browsers send with each: programs use no cookie.
    """
    origin = request.headers.get("origin")
    if request.method not in READING and not (origin and is_own_origin(request, origin, settings)):
        detail = (
            f"with a session only our own pages may write, not {origin!r} ({PROXY}); programs send their key"
        )
        raise Problem(403, "foreign-origin", detail)


def is_own_origin(request: Request, origin: str, settings: ApiSettings) -> bool:
    """True for an origin with the very scheme, host and port of the request, or with a proxy's name for us.

    A proxy that does not pass on the `Host` must have its name in `allowed_hosts`, and the port of its scheme.
    """
    scheme, _, netloc = origin.lower().partition("://")
    if scheme != ("https" if _is_over_tls(request) else "http"):
        return False
    names = {request.headers.get("host", "").lower(), *(name.lower() for name in settings.allowed_hosts)}
    return netloc != "" and netloc in names


def _set(request: Request, response: Response, value: str, max_age_s: int) -> None:
    response.set_cookie(
        _name(request),
        value,
        max_age=max_age_s,
        path="/",
        secure=_is_over_tls(request),
        httponly=True,
        samesite="strict",
    )
    response.headers["Cache-Control"] = "no-store"


def _name(request: Request) -> str:
    return NAME_OVER_TLS if _is_over_tls(request) else NAME


def _is_over_tls(request: Request) -> bool:
    """True when the browser speaks TLS, with the proxy in front of us; a lie harms its teller alone."""
    return request.headers.get("x-forwarded-proto", request.url.scheme).partition(",")[0].strip() == "https"
