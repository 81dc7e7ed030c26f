"""`stonefall keys`: create, pair, list and revoke keys of the REST interface; a running daemon knows at once."""

import getpass
import json
import os
import re
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from drivers.files.times import utc_now
from pipeline.frames import rfc3339
from service.base.errors import StoreError, UsageError
from service.commands.daemon_client import DaemonClient, DaemonError
from service.commands.options import DaemonConfig
from service.configuration.settings import Settings, load_settings
from service.store.keys import AccessKey, create_key, revoke_key, stored_keys
from service.store.pairings import key_without_token, pair_screen, waiting_screen
from service.web.settings import Role, Scope

ANSWER_S = 5.0
"""Longest wait for a daemon that need not run."""
command = typer.Typer(
    no_args_is_help=True, help="Keys of the REST interface; changes apply to a running daemon at once."
)

Name = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the key: the person or program that uses it.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


@command.command()
def create(
    name: Name,
    config: DaemonConfig,
    scopes: Annotated[
        list[Scope] | None, typer.Option("--scope", help="Scope of the key; may be repeated; default: read.")
    ] = None,
    expires: Annotated[
        str | None,
        typer.Option(help="Expiry: a date, a time (UTC without an offset), or a number of days: 90d."),
    ] = None,
    display: Annotated[
        bool,
        typer.Option(
            "--display",
            help="For a wall screen: it only reads, and stays signed in until the key is revoked.",
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Create a key and print its token, this once."""
    settings = load_settings(config)
    _require_not_configured(settings, name)
    wanted = tuple(dict.fromkeys(scopes or [Scope.READ]))
    if display and wanted != (Scope.READ,):
        raise UsageError("--display: a display only reads: give it no other --scope")
    expires_at = None if expires is None else _expiry(expires, datetime.now(UTC))
    first = _what_the_first_key_ends(settings)
    key, token = create_key(settings.store.dir, name, wanted, expires_at, _user(), is_display=display)
    _tell(first)
    if as_json:
        shown = {"name": name, "scopes": key.scopes, "expires_at": key.expires_at, "token": token}
        typer.echo(json.dumps(shown))
        return
    typer.echo(token)
    until = "" if key.expires_at is None else f" until {key.expires_at}"
    typer.echo(f"key {name} may {', '.join(wanted)}{until}; its token is not shown again", err=True)


@command.command()
def pair(
    code: Annotated[str, typer.Argument(metavar="CODE", help="The six digits that the screen shows.")],
    name: Annotated[
        str | None, typer.Option(help="Name of the screen: its place; without it, it is asked for.")
    ] = None,
    role: Annotated[Role, typer.Option(help="What the screen is for.")] = Role.DISPLAY,
    yes: Annotated[
        bool, typer.Option("--yes", help="Do not ask whether it is the right screen; needs --name.")
    ] = False,
    *,
    config: DaemonConfig,
) -> None:
    """Sign in the screen that shows a code: it gets a key of its own."""
    settings = load_settings(config)
    if yes and name is None:
        raise UsageError("--yes: give the screen a --name")
    screen = waiting_screen(settings.store.dir, code)
    typer.echo(
        f"code {code} is shown at {screen.address or 'this machine'} by: {screen.user_agent or 'unknown'}"
    )
    first = _what_the_first_key_ends(settings)
    _tell(first)
    if not yes:
        typer.confirm("is that the screen before you?", abort=True)
    name = name or typer.prompt("name of the screen")
    _require_not_configured(settings, name)
    key = key_without_token(name, role.scopes, _user(), is_display=role is Role.DISPLAY)
    pair_screen(settings.store.dir, code, key)
    typer.echo(
        f"key {name} may {', '.join(key.scopes)}; its screen signs itself in within seconds, and"
        f" `stonefall keys revoke {name}` signs it out"
    )


@command.command("list")
def list_(config: DaemonConfig, as_json: AsJson = False) -> None:
    """List all keys, those of the configuration as well."""
    settings = load_settings(config)
    now = utc_now()
    shown = ("is_display", "created_at", "created_by", "expires_at", "revoked_at", "revoked_by")
    configured = [AccessKey(key.sha256, key.name, key.scopes) for key in settings.api.keys]
    keys: list[dict[str, Any]] = [  # without their hashes
        {
            "name": key.name,
            "scopes": key.scopes,
            "state": "revoked" if key.revoked_at else "expired" if key.refusal(now) else "valid",
            **{each: getattr(key, each) for each in shown},
        }
        for key in (*configured, *stored_keys(settings.store.dir))
    ]
    if as_json:
        typer.echo(json.dumps({"items": keys}))
        return
    table = Table("name", "scopes", "state", "created", "by", "expires")
    for key in keys:
        created = (_day(key["created_at"]) or "in the configuration", key["created_by"] or "")
        scopes = [*key["scopes"], *(["display"] if key["is_display"] else [])]
        table.add_row(
            key["name"], ", ".join(scopes), key["state"], *created, _day(key["expires_at"]) or "never"
        )
    Console().print(table)


@command.command()
def revoke(name: Name, config: DaemonConfig) -> None:
    """Revoke a key: requests with it are refused from now on."""
    settings = load_settings(config)
    _require_not_configured(settings, name)
    revoke_key(settings.store.dir, name, _user())
    typer.echo(f"key {name} is revoked")


def _what_the_first_key_ends(settings: Settings) -> str | None:
    """Return the words about clients that the first key shuts out, as a running daemon knows them; None with others."""
    try:
        if settings.api.keys or stored_keys(settings.store.dir):
            return None
    except StoreError:  # there were some, which are lost
        return None
    seen: list[dict[str, str]] = []
    with suppress(DaemonError):
        seen = DaemonClient(settings.api.local_url).ask("/session", timeout_s=ANSWER_S)["keyless"]
    reads = " but for reading on this machine" if settings.api.loopback_reads_without_key else ""
    clients = [f"  {each['address']}  {each['user_agent']}" for each in seen]
    asked = ["these asked without one since the daemon started:", *clients] if clients else []
    said = f"this is the first key: from now on every page and program needs one{reads}; pages ask for it by themselves"
    return "\n".join([said, *asked])


def _tell(first: str | None) -> None:
    if first is not None:
        typer.echo(first, err=True)


def _require_not_configured(settings: Settings, name: str) -> None:
    if any(key.name == name for key in settings.api.keys):
        raise UsageError(f"key {name!r} is in the configuration, [[api.keys]]: change it there, then reload")


def _expiry(text: str, now: datetime) -> str:
    """Return the time, RFC 3339, from which a key is not accepted any more."""
    try:
        if days := re.fullmatch(r"([0-9]{1,5})d", text):
            end = now + timedelta(days=int(days[1]))
        else:
            end = datetime.fromisoformat(text)
            end = end if end.tzinfo is not None else end.replace(tzinfo=UTC)
        if end <= now:
            raise UsageError(f"--expires {text}: is over already")
        return rfc3339(end.astimezone(UTC))
    except (ValueError, OverflowError):
        raise UsageError(
            f"--expires {text}: must be a date such as 2027-01-01, or days such as 90d"
        ) from None


def _day(time: str | None) -> str | None:
    return None if time is None else time[:10]


def _user() -> str:
    """Return the user who runs the command, for the audit."""
    try:
        return os.environ.get("SUDO_USER") or getpass.getuser()
    except (KeyError, OSError):  # a user without a name
        return f"user {os.getuid()}"
