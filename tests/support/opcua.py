"""A plant without a daemon, and clients of OPC UA with certificates, for tests of the OPC UA server."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from asyncua import Client, ua
from asyncua.crypto.cert_gen import generate_private_key, generate_self_signed_app_certificate
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import ExtendedKeyUsageOID

from service.bridge.opcua.space import NAMESPACE
from service.bridge.plant import OrderRefusedError
from service.bridge.plant_state import PlantAlarm, PlantState
from service.bridge.reference_client import Position, Step

CLIENT_URI = "urn:tests:client"
GATE = PlantAlarm(
    id=17, check="gate", priority="urgent", state="unacknowledged", detail="the beam is closed",
    raised_at="2026-11-28T06:00:00Z", acknowledged_by=None, cause="The light gate sees nothing.",
    action="Clean it.",
)  # fmt: skip
ARMED = PlantState(
    daemon_answers=True, trouble=None, at="2026-11-28T06:00:01Z", instance_id="h-1", ready=True, acquisition="armed",
    last_seq=0, stones_per_min=0, triggers=0, measured=0, rejected=0, lost=0,
)  # fmt: skip


def result(seq: int, **fields: Any) -> dict[str, Any]:
    """Return a lean result as the feed has it."""
    return {
        "seq": seq, "id": f"s-{seq:08d}", "revision": 1, "revises": None, "kind": "particle", "n_stones": 1,
        "captured_at": "2026-11-28T06:00:00.500Z", "recorded_at": "2026-11-28T06:00:01.000Z",
        "time_is_doubtful": False, "outcome": "measured", "reason": None, "quality": "good", "volume_mm3": 905.3,
        "volume_sd_percent": 0.4, "surface_sd_mm": 0.01, "length_mm": 15.1, "width_mm": 12.0, "thickness_mm": 9.0,
        "max_feret_mm": 15.1, "min_feret_mm": 8.9, "sieve_size_mm": 11.4, "equivalent_diameter_mm": 12.0,
        "mass_g": None, "calibration_id": "c-1", "verification": "never", "is_simulated": True, "is_replay": True,
        "lot": "L-1", **fields,
    }  # fmt: skip


class FakePlant:
    """Stands for `service.bridge.plant.Plant`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.state = PlantState()
        self.orders: list[tuple[str, object, str | None]] = []
        self.refusal: OrderRefusedError | None = None
        self.history: list[dict[str, Any]] = []
        self._changed = asyncio.Event()
        self._steps: asyncio.Queue[Step] = asyncio.Queue()

    def be(self, **changes: Any) -> None:
        """Change the state."""
        self.state = replace(self.state, **changes)
        self._changed.set()

    async def states(self) -> AsyncIterator[PlantState]:
        while True:
            self._changed.clear()
            yield self.state
            await self._changed.wait()

    def fall(self, *results: dict[str, Any]) -> None:
        """Have results come in one step of the feed."""
        self.history += results
        self._steps.put_nowait(Step(Position("h-1", results[-1]["seq"]), results))

    async def results(self, outlet: str) -> AsyncIterator[Step]:
        while True:
            yield await self._steps.get()

    async def open_lot(self, lot: str, product: str, token: str | None = None, **more: Any) -> dict[str, Any]:
        return self._ordered(f"open {lot} of {product}", more, token)

    async def close_lot(self, lot: str, token: str | None = None) -> dict[str, Any]:
        return self._ordered(f"close {lot}", {}, token)

    async def acknowledge(self, alarm: int, token: str | None = None) -> dict[str, Any]:
        return self._ordered(f"acknowledge {alarm}", {}, token)

    async def get(self, path: str, **query: Any) -> dict[str, Any]:
        if path == "/results":
            items = [each for each in self.history if each["seq"] > query["after"]][: query["limit"]]
            last_seq = self.history[-1]["seq"] if self.history else 0
            return {"instance_id": "h-1", "first_seq": 1, "last_seq": last_seq, "items": items}
        for each in self.history:
            if path == f"/particles/{each['id']}":
                return {**each, "optics": {}}
        raise OrderRefusedError("404 unknown-particle: there is none", "unknown-particle")

    def _ordered(self, what: str, more: object, token: str | None) -> dict[str, Any]:
        self.orders.append((what, more, token))
        if self.refusal is not None:
            raise self.refusal
        return {}


@dataclass(frozen=True)
class Identity:
    """Certificate and key of a client, as files."""

    certificate: Path
    key: Path

    @property
    def der(self) -> bytes:
        return self.certificate.read_bytes()

    @property
    def security(self) -> str:
        """Option `--security` of asyncua's commands."""
        return f"Basic256Sha256,SignAndEncrypt,{self.certificate},{self.key}"


def make_identity(folder: Path, name: str, days: int = 30) -> Identity:
    """Make a certificate with its key."""
    key = generate_private_key()
    certificate = generate_self_signed_app_certificate(
        key, name, {}, [x509.UniformResourceIdentifier(CLIENT_URI)], [ExtendedKeyUsageOID.CLIENT_AUTH], days
    )
    identity = Identity(folder / f"{name}.der", folder / f"{name}.pem")
    identity.certificate.write_bytes(certificate.public_bytes(Encoding.DER))
    identity.key.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return identity


async def secured(
    url: str,
    identity: Identity,
    user: tuple[str, str] | None = None,
    mode: ua.MessageSecurityMode = ua.MessageSecurityMode.SignAndEncrypt,
) -> Client:
    """Return a client that signs with a certificate, not connected yet."""
    client = Client(url, timeout=60)
    client.application_uri = CLIENT_URI
    await client.set_security(SecurityPolicyBasic256Sha256, identity.certificate, identity.key, mode=mode)
    if user is not None:
        client.set_user(user[0])
        client.set_password(user[1])
    return client


class Heard:
    """What a subscription has notified of."""

    def __init__(self) -> None:
        self.events: asyncio.Queue[Any] = asyncio.Queue()
        self.values: asyncio.Queue[Any] = asyncio.Queue()

    def event_notification(self, event: Any) -> None:
        self.events.put_nowait(event)

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        self.values.put_nowait((node.nodeid.Identifier, data.monitored_item.Value))


async def node_of(client: Client, path: str) -> Any:
    """Return a node by its path below `VisionSystem`, its namespace looked up by URI."""
    index = await client.get_namespace_index(NAMESPACE)
    return client.get_node(ua.NodeId(f"VisionSystem.{path}".removesuffix("."), index))
