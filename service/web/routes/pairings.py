"""Sign a screen in by a code that it shows and a person confirms, after the device authorization grant (RFC 8628)."""

import time
from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response
from pydantic import Field

from pipeline.frames import rfc3339
from service.base.ids import NEW_ID
from service.base.qr import qr_svg
from service.base.schema import Time, request_body, served
from service.store.pairings import (
    LASTS_S,
    Pairing,
    UnknownPairingError,
    confirm_pairing,
    key_without_token,
    open_pairing,
)
from service.web.auth import CONFIGURABLE, Who
from service.web.clients import Client, agent_of, host_of_client, pause_problem
from service.web.context import ApiContext, Context
from service.web.pairings import POLL_S
from service.web.problems import Problem, problem_responses
from service.web.routes.session import begin_session
from service.web.sessions import own_address, require_own_sign_in
from service.web.settings import Role, Scope

router = APIRouter(tags=["session"])

Code = Annotated[str, Path(pattern=r"^[0-9]{6}$", description="The six digits that a screen shows")]


@served
class PairingDocument:
    """What a screen shows while it waits to be signed in, and its secret."""

    code: str
    """Six digits, to be confirmed by a person who may make keys"""
    secret: str
    """To ask with whether it was confirmed; no other screen has it"""
    expires_at: Time
    """When the code has run out, RFC 3339 UTC: then ask for another one"""
    poll_s: int
    """Seconds to wait between two questions"""
    confirm_at: str | None
    """Address of the page that confirms the code; null if only this machine finds it"""
    qr_svg: str | None
    """This address as QR code, an SVG; null without one"""


@request_body
class Claim:
    """The screen that asks whether its code was confirmed."""

    secret: Annotated[str, Field(min_length=1, max_length=128, repr=False)]
    """As it was given with the code"""


@served
class ClaimDocument:
    """Whether the screen is signed in now."""

    is_signed_in: bool
    """True once, with the cookie of the session; false while the code waits to be confirmed"""


@served
class WaitingScreen:
    """A screen that shows a code: to be compared with the one that is meant."""

    code: str
    """Its code"""
    address: str
    """Network address that it asks from"""
    user_agent: str
    """What its browser says of itself, which may be a lie"""
    opened_at: Time
    """Since when it shows the code, RFC 3339 UTC"""


@request_body
class Confirmation:
    """What the screen shall be."""

    name: Annotated[str, Field(pattern=NEW_ID)]
    """Name of its key, which the audit has: the place of the screen"""
    role: Role
    """`display` only reads and stays signed in until its key is revoked; `operator` may work with lots and alarms;
    `engineer` may do all"""


@served
class PairedScreen:
    """The key that a screen was given."""

    name: str
    """Name of the key; `stonefall keys revoke NAME` signs the screen out"""
    scopes: list[Scope]
    """What may be asked for with it"""
    is_display: bool
    """Whether it only reads, and stays signed in until the key is revoked"""
    asked_from_now_on: list[Client]
    """With the first key: clients that asked without one until now, the newest first; from now on they need one"""


@router.post("/session/pairing", status_code=201, responses=problem_responses(403, 429))
async def begin_pairing(request: Request, response: Response, context: Context) -> PairingDocument:
    """Show a code: ask to be signed in by a person who confirms it elsewhere. Needs no key.

    The code opens nothing by itself. 429 `too-many-pairings` while 16 screens wait, `too-many-attempts` after ten
    codes for one address.
    """
    require_own_sign_in(request, context.settings)
    address = host_of_client(request)
    pairing, secret = await context.pairings.begin(context.store, address, agent_of(request))
    own = own_address(request, context.settings)
    confirm_at = None if own is None else f"{own}/setup?code={pairing.code}#screens"
    response.headers["Cache-Control"] = "no-store"
    return PairingDocument(
        code=pairing.code,
        secret=secret,
        expires_at=_time(pairing.opened_s + LASTS_S),
        poll_s=POLL_S,
        confirm_at=confirm_at,
        qr_svg=None if confirm_at is None else qr_svg(confirm_at),
    )


@router.post("/session/pairing/claim", responses=problem_responses(401, 403, 404))
async def claim_pairing(
    request: Request, response: Response, context: Context, claim: Claim
) -> ClaimDocument:
    """Ask whether the code was confirmed: then the answer has the cookie of a session, once.

    404 `unknown-pairing` when the code has run out or the daemon was started anew: ask for another one.
    """
    require_own_sign_in(request, context.settings)
    response.headers["Cache-Control"] = "no-store"
    key_sha256 = context.pairings.key_of(context.store, claim.secret)
    if key_sha256 is None:
        return ClaimDocument(is_signed_in=False)
    context.keys.refresh()
    key = context.keys.of_sha256(key_sha256)
    if key is None or key.refusal(rfc3339(datetime.now(UTC))) is not None:
        raise Problem(401, "unauthorized", "the key of this screen was revoked before it came")
    await begin_session(request, response, context, key)
    return ClaimDocument(is_signed_in=True)


@router.get("/pairings/{code}", dependencies=CONFIGURABLE, responses=problem_responses(404))
async def waiting_screen(request: Request, context: Context, code: Code) -> WaitingScreen:
    """Get the screen that shows a code: confirm it only if that is the one before you.

    404 `unknown-pairing` if no screen shows it now; 429 after ten wrong ones.
    """
    pairing = await _waiting(request, context, code)
    return WaitingScreen(
        code=code,
        address=pairing.address,
        user_agent=pairing.user_agent,
        opened_at=_time(pairing.opened_s),
    )


@router.post("/pairings/{code}/confirm", dependencies=CONFIGURABLE, responses=problem_responses(404, 409))
async def confirm(
    request: Request, context: Context, code: Code, wanted: Confirmation, asking: Who
) -> PairedScreen:
    """Confirm a code: the screen that shows it gets a key of its own and signs itself in.

    No key gives more than it has. 404 `unknown-pairing` as above; 409 `key-conflict` if the name is taken.
    """
    await _waiting(request, context, code)
    missing = set(wanted.role.scopes) - set(request.state.scopes)
    if missing:
        raise Problem(
            403, "forbidden", f"{asking} may not give {', '.join(sorted(missing))}: it lacks that itself"
        )
    key = key_without_token(wanted.name, wanted.role.scopes, asking, is_display=wanted.role is Role.DISPLAY)
    keyless = context.keyless.newest() if context.keys.is_empty else []
    await context.write(confirm_pairing, context.store.path.parent, code, key, asking)
    return PairedScreen(
        name=key.name,
        scopes=[Scope(each) for each in key.scopes],
        is_display=key.is_display,
        asked_from_now_on=keyless,
    )


async def _waiting(request: Request, context: ApiContext, code: str) -> Pairing:
    """Return the screen that shows a code; too many wrong ones from one address have it wait."""
    host, now_s = host_of_client(request), time.monotonic()
    if (pause_s := context.codes.pause_s(host, now_s)) > 0:
        raise pause_problem("wrong codes came", host, pause_s)
    try:
        return await context.store.read(open_pairing, code)
    except UnknownPairingError:
        context.codes.note(host, now_s)
        raise


def _time(seconds: int) -> str:
    return rfc3339(datetime.fromtimestamp(seconds, UTC))
