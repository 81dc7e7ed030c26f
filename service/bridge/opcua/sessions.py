"""Sessions that are checked, bounded, and reach nothing of another's.

asyncua leaves to its user what is added here: sessions and subscriptions that are taken over by their guessable
numbers, filters that fail with each event, periods of no time.
"""

import logging
import math
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from asyncua import ua
from asyncua.common.event_objects import BaseEvent
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.ua.uaerrors import UaStatusCodeError

from service.base.addresses import is_loopback
from service.bridge.opcua.access import Access, ClientRefusedError
from service.bridge.opcua.methods import Caller, MethodTable

MAX_CONNECTIONS = 32
MAX_SESSIONS_OF_CONNECTION = 8
"""Sessions that a connection may make, one after the other."""
MAX_SUBSCRIPTIONS = 200
MAX_SUBSCRIPTIONS_OF_SESSION = 10
MAX_ITEMS_OF_SESSION, MAX_EVENT_ITEMS_OF_SESSION = 2000, 4
MAX_QUEUE = 500
"""Values or events that wait for a slow client; then the oldest is dropped."""
MAX_UNACKNOWLEDGED = 50
"""Messages that are kept to be sent again."""
MAX_NODES, MAX_BROWSED, MAX_CALLS = 1000, 100, 10
"""Nodes, nodes that are browsed, and calls of one request."""
SCHEMAS = frozenset(
    ua.NodeId(number) for number in (ua.ObjectIds.OpcUa_BinarySchema, ua.ObjectIds.OpcUa_XmlSchema)
)
"""Nodes with values of hundreds of kilobytes; no others have more than some hundred bytes."""
MAX_SELECTED, MAX_CONDITIONS = 200, 100
"""Fields and elements of the filter of an event."""
MAX_WAITING = 100
"""Requests of a connection that wait."""
INTERVAL_MS = (50.0, 60_000.0)
"""Shortest and longest publishing interval."""
ACTIVATION_S = 10.0
"""Longest time from a connection to a session that may read."""
SESSION_S = (5.0, 3600.0)
"""Shortest and longest time that a silent session is kept."""
NOBODY = User(role=UserRole.Anonymous)
EVENTS = ua.AttributeIds.EventNotifier
WEAK = ("rsa-1_5", "rsa-sha1")
"""Ends of the names of algorithms that Basic256Sha256 does not have, and asyncua takes."""


class BoundedSession(InternalSession):
    """A session whose user is checked, and that reaches its own subscriptions only."""

    iserver: "BoundedInternalServer"
    mode = ua.MessageSecurityMode.None_
    """Security of its channel: one that is signed has the key of a trusted certificate."""

    @property
    def address(self) -> str:
        """Address of the client."""
        return host_of(self.name)

    def activate_session(
        self, params: ua.ActivateSessionParameters, peer_certificate: bytes | None
    ) -> ua.ActivateSessionResult:
        """Check who asks; raise `ServiceError` and report it, if they may not."""
        access, token = self.iserver.access, params.UserIdentityToken
        attempt = (self.address, token.UserName) if isinstance(token, ua.UserNameIdentityToken) else None
        if attempt is not None:
            access.check_pace(attempt)
        try:
            is_anonymous = not isinstance(token, (ua.UserNameIdentityToken, ua.X509IdentityToken))
            if is_anonymous and not is_loopback(self.address):
                raise ClientRefusedError(
                    ua.StatusCodes.BadIdentityTokenRejected, "is anonymous, and not of this machine"
                )
            if not is_anonymous and self.mode == ua.MessageSecurityMode.None_:
                raise ClientRefusedError(
                    ua.StatusCodes.BadSecurityModeRejected, "signs in over a channel that is not secured"
                )
            is_signed_only = self.mode == ua.MessageSecurityMode.Sign
            if attempt is not None and is_signed_only and not token.EncryptionAlgorithm:
                raise ClientRefusedError(
                    ua.StatusCodes.BadIdentityTokenInvalid, "sends its password in plain text"
                )
            return super().activate_session(params, None)  # of a certificate its own, not that of the channel
        except (ServiceError, UaStatusCodeError) as err:
            if attempt is not None:
                access.note_wrong(attempt)
            access.tell(self.address, err)
            raise

    async def read(self, params: ua.ReadParameters) -> Any:
        """Read a bounded number of attributes."""
        _bound(params.NodesToRead, MAX_NODES)
        _bound([each for each in params.NodesToRead if each.NodeId in SCHEMAS], len(SCHEMAS))
        return await super().read(params)

    async def browse(self, params: ua.BrowseParameters) -> Any:
        """Browse a bounded number of nodes."""
        _bound(params.NodesToBrowse, MAX_BROWSED)
        return await super().browse(params)

    async def translate_browsepaths_to_nodeids(self, params: list[ua.BrowsePath]) -> Any:
        """Follow a bounded number of paths."""
        _bound(params, MAX_NODES)
        return await super().translate_browsepaths_to_nodeids(params)

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        """Refuse to write: no node can be written."""
        self.iserver.access.tell(self.address, f"{self.user.name or 'anonymous'} writes to a node")
        return [ua.StatusCode(ua.StatusCodes.BadNotWritable) for _ in params.NodesToWrite]

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        """Call methods of the table; any other is refused."""
        _bound(params, MAX_CALLS)
        caller = Caller(self.user, self.address, self.owns)
        return [await self.iserver.methods.call(caller, request) for request in params]

    async def create_subscription(
        self,
        params: ua.CreateSubscriptionParameters,
        callback: Callable[..., Any],
        request_callback: Callable[..., Any] | None = None,
    ) -> ua.CreateSubscriptionResult:
        """Create one of a bounded number of subscriptions, with a bounded interval."""
        if len(list(self._subscriptions())) >= MAX_SUBSCRIPTIONS_OF_SESSION:
            raise ServiceError(ua.StatusCodes.BadTooManySubscriptions)
        shortest, longest = INTERVAL_MS
        asked = params.RequestedPublishingInterval
        params.RequestedPublishingInterval = (
            min(max(asked, shortest), longest) if math.isfinite(asked) else 1000.0
        )
        result = await super().create_subscription(params, callback, request_callback)
        # each subscription has a logger of its own, which the logging module would keep for ever
        name = f"asyncua.server.monitored_item_service.{result.SubscriptionId}"
        logging.Logger.manager.loggerDict.pop(name, None)
        return result

    async def create_monitored_items(self, params: ua.CreateMonitoredItemsParameters) -> Any:
        """Watch a bounded number of nodes, with filters that cannot fail later."""
        self._own(params.SubscriptionId)
        watched = [
            item.read_value_id.AttributeId
            for each in self._subscriptions()
            for item in each.monitored_item_srv._monitored_items.values()
        ]
        watched += [item.ItemToMonitor.AttributeId for item in params.ItemsToCreate]
        _bound(watched, MAX_ITEMS_OF_SESSION)
        _bound([each for each in watched if each == EVENTS], MAX_EVENT_ITEMS_OF_SESSION)
        for item in params.ItemsToCreate:
            check_filter(item.ItemToMonitor.AttributeId, item.RequestedParameters.Filter)
        return await super().create_monitored_items(params)

    async def modify_monitored_items(self, params: ua.ModifyMonitoredItemsParameters) -> Any:
        """Change the queues of watched nodes; a filter stays as it was made."""
        self._own(params.SubscriptionId)
        for item in params.ItemsToModify:
            item.RequestedParameters.QueueSize = min(
                item.RequestedParameters.QueueSize or MAX_QUEUE, MAX_QUEUE
            )
            item.RequestedParameters.Filter = None
        return await super().modify_monitored_items(params)

    async def delete_monitored_items(self, params: ua.DeleteMonitoredItemsParameters) -> Any:
        """Watch nodes no longer."""
        self._own(params.SubscriptionId)
        return await super().delete_monitored_items(params)

    async def set_monitoring_mode(self, params: ua.SetMonitoringModeParameters) -> Any:
        """Switch watched nodes on or off."""
        self._own(params.SubscriptionId)
        return await super().set_monitoring_mode(params)

    async def set_publishing_mode(self, params: ua.SetPublishingModeParameters) -> Any:
        """Switch subscriptions on or off."""
        self._own(*params.SubscriptionIds)
        return await super().set_publishing_mode(params)

    async def delete_subscriptions(self, ids: list[int]) -> Any:
        """Delete subscriptions."""
        self._own(*ids)
        return await super().delete_subscriptions(ids)

    def modify_subscription(self, params: ua.ModifySubscriptionParameters) -> ua.ModifySubscriptionResult:
        """Return the parameters of a subscription, which stay as they were made."""
        self._own(params.SubscriptionId)
        return super().modify_subscription(params)

    def republish(self, params: ua.RepublishParameters) -> ua.NotificationMessage:
        """Return a message again that was not acknowledged."""
        self._own(params.SubscriptionId)
        return super().republish(params)

    def publish(
        self, acks: Iterable[ua.SubscriptionAcknowledgement] | None = None
    ) -> tuple[int, list[ua.StatusCode]]:
        """Acknowledge messages, of its own subscriptions only."""
        mine = [ack for ack in acks or () if self.owns(ack.SubscriptionId)]
        _, results = super().publish(mine)
        return len(list(self._subscriptions())), results

    def owns(self, subscription_id: int) -> bool:
        """True for a subscription of this session."""
        found = self.subscription_service.subscriptions.get(subscription_id)
        return found is not None and found.session_id == self.session_id

    def _own(self, *ids: int) -> None:
        if not all(map(self.owns, ids)):
            raise ServiceError(ua.StatusCodes.BadSubscriptionIdInvalid)

    def _subscriptions(self) -> Iterable[Any]:
        subscriptions = self.subscription_service.subscriptions.values()
        return (each for each in subscriptions if each.session_id == self.session_id)


class BoundedInternalServer(InternalServer):
    """Makes bounded sessions, keeps none for another connection, and registers no other server."""

    def __init__(self, access: Access, methods: MethodTable) -> None:
        super().__init__(user_manager=access)
        self.access, self.methods = access, methods
        self._n_sessions: Counter[object] = Counter()
        self.max_session_timeout_ms, self.min_session_timeout_ms = 1000 * SESSION_S[1], 1000 * SESSION_S[0]
        self.max_unacked_messages_per_subscription = MAX_UNACKNOWLEDGED
        self.max_monitored_item_queue_size = MAX_QUEUE
        self.max_pending_messages_per_connection = MAX_WAITING
        self.max_connections = MAX_CONNECTIONS
        self.max_pending_activation_seconds = ACTIVATION_S
        self.max_subscriptions = MAX_SUBSCRIPTIONS
        self.allow_remote_admin = False

    def create_session(self, name: str, user: User = NOBODY, external: bool = False) -> InternalSession:
        """Create one of a bounded number of sessions of a connection."""
        there = {transport.get_extra_info("peername") for transport in self.asyncio_transports}
        self._n_sessions = Counter({peer: n for peer, n in self._n_sessions.items() if peer in there})
        self._n_sessions[name] += 1
        if self._n_sessions[name] > MAX_SESSIONS_OF_CONNECTION:
            raise ServiceError(ua.StatusCodes.BadTooManySessions)
        return BoundedSession(
            self, self.aspace, self.subscription_service, name, user=user, external=external
        )

    def decrypt_user_token(self, isession: Any, token: ua.UserNameIdentityToken) -> Any:
        """Decrypt a password, but for algorithms that are not of the policy."""
        if (token.EncryptionAlgorithm or "").endswith(WEAK):
            raise ServiceError(ua.StatusCodes.BadIdentityTokenInvalid)
        return super().decrypt_user_token(isession, token)

    def verify_x509_token(
        self, isession: Any, token: ua.X509IdentityToken, signature: ua.SignatureData
    ) -> Any:
        """Verify the signature of a user, but for algorithms that are not of the policy."""
        if (signature.Algorithm or "").endswith(WEAK):
            raise ServiceError(ua.StatusCodes.BadUserSignatureInvalid)
        return super().verify_x509_token(isession, token, signature)

    def register_external_session(self, session: InternalSession) -> None:
        """Keep no session for another connection: its number can be guessed."""

    def register_server(self, server: Any, conf: Any = None) -> None:
        """Refuse: this is no discovery server, and anybody may ask."""
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)


def host_of(peer: object) -> str:
    """Return the address of a client."""
    return str(peer[0]) if isinstance(peer, tuple) else "?"  # a socket that is closed has none


def _bound(items: list[Any], most: int) -> None:
    if len(items) > most:
        raise ServiceError(ua.StatusCodes.BadTooManyOperations)


def check_filter(attribute: int, wanted: object) -> None:
    """Raise `ServiceError` for a filter that would fail, or take for ever, when there is something to be sent."""
    if attribute != EVENTS:
        if not wanted:  # also a structure of no type, which is how none is sent
            return
        if isinstance(wanted, ua.DataChangeFilter) and wanted.DeadbandType == ua.DeadbandType.None_:
            return
        raise ServiceError(ua.StatusCodes.BadMonitoredItemFilterUnsupported)
    if not isinstance(wanted, ua.EventFilter):
        raise ServiceError(ua.StatusCodes.BadEventFilterInvalid)
    if len(wanted.SelectClauses) > MAX_SELECTED or len(wanted.WhereClause.Elements) > MAX_CONDITIONS:
        raise ServiceError(ua.StatusCodes.BadEventFilterInvalid)
    try:
        BaseEvent().to_event_fields(wanted.SelectClauses)
    except Exception as err:  # whatever the library makes of a client's clauses
        raise ServiceError(ua.StatusCodes.BadEventFilterInvalid) from err
    # a tree of elements is evaluated in as many steps; one that is referred to twice, and that again, in 2^n
    seen: set[int] = set()
    for place, element in enumerate(wanted.WhereClause.Elements):
        for operand in element.FilterOperands:
            if isinstance(operand, ua.ElementOperand):
                if operand.Index <= place or operand.Index in seen:
                    raise ServiceError(ua.StatusCodes.BadEventFilterInvalid)
                seen.add(operand.Index)
