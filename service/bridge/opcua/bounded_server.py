"""An OPC UA server that a slow or hostile client can neither stop, nor fill, nor reach what is another's.

asyncua leaves to its user what this module adds: messages without a secure channel, sessions and subscriptions that
are taken over by their guessable numbers, filters that fail with each event, periods of no time, answers that nobody
reads, and bodies of gigabytes.
"""

import asyncio
import logging
import math
import uuid
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.common.connection import TransportLimits
from asyncua.common.event_objects import BaseEvent
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import PermissionRuleset, User, UserRole
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import uatcp_to_binary
from asyncua.ua.uaerrors import UaStatusCodeError

from service.base.addresses import is_loopback
from service.bridge.opcua.access import Access, ClientRefusedError
from service.bridge.opcua.certificates import now_utc
from service.bridge.opcua.methods import Caller, MethodTable

log = logging.getLogger(__name__)

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
MAX_MESSAGE_BYTES = 1_000_000
MAX_UNREAD_BYTES = 8_000_000
"""Answers that a client has not read, before its connection is closed."""
MAX_WAITING = 100
"""Requests of a connection that wait."""
INTERVAL_MS = (50.0, 60_000.0)
"""Shortest and longest publishing interval."""
ACTIVATION_S = 10.0
"""Longest time from a connection to a session that may read."""
SESSION_S = (5.0, 3600.0)
"""Shortest and longest time that a silent session is kept."""
LINGER_S = 2.0
"""Time to read the last answer in, once a connection is closed."""
BUFFER_BYTES, LEAST_BUFFER_BYTES = 65_535, 8192
"""Largest chunk, and the least that a client must be able to take (OPC 10000-6, 7.1.2.3)."""

OPERATION_LIMITS = {
    "MaxNodesPerRead": MAX_NODES,
    "MaxNodesPerWrite": MAX_NODES,
    "MaxNodesPerBrowse": MAX_BROWSED,
    "MaxNodesPerMethodCall": MAX_CALLS,
    "MaxNodesPerTranslateBrowsePathsToNodeIds": MAX_NODES,
    "MaxNodesPerRegisterNodes": MAX_NODES,
    "MaxMonitoredItemsPerCall": MAX_ITEMS_OF_SESSION,
}
NOBODY = User(role=UserRole.Anonymous)
EVENTS = ua.AttributeIds.EventNotifier
WEAK = ("rsa-1_5", "rsa-sha1")
"""Ends of the names of algorithms that Basic256Sha256 does not have, and asyncua takes."""
NO_SECURITY = "http://opcfoundation.org/UA/SecurityPolicy#None"

SERVICES = frozenset(
    ua.NodeId(getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary"))
    for name in (
        "CloseSession", "ActivateSession", "Read", "Write", "Browse", "TranslateBrowsePathsToNodeIds",
        "CreateSubscription", "ModifySubscription", "DeleteSubscriptions", "CreateMonitoredItems",
        "ModifyMonitoredItems", "DeleteMonitoredItems", "SetMonitoringMode", "SetPublishingMode", "Publish",
        "Republish", "Call", "RegisterNodes", "UnregisterNodes",
    )
)  # fmt: skip
"""Services that a session may ask for; nothing that changes the address space, and no history."""


class BoundedLimits(TransportLimits):
    """Sizes of messages; a client that takes only tiny chunks would have each answer cut into thousands."""

    def create_acknowledge_and_set_limits(self, msg: ua.Hello) -> ua.Acknowledge:
        """Agree on sizes with a client; raise `ServiceError` if its own are too small."""
        if min(msg.ReceiveBufferSize, msg.SendBufferSize) < LEAST_BUFFER_BYTES:
            raise ServiceError(ua.StatusCodes.BadConnectionRejected)
        return super().create_acknowledge_and_set_limits(msg)


class ServedServices(PermissionRuleset):
    """Refuses all services but those in `SERVICES`."""

    def check_validity(self, user: User, action_type: ua.NodeId, body: object) -> bool:
        """Return False for a service that nobody may ask for."""
        return action_type in SERVICES


class BoundedSession(InternalSession):
    """A session whose user is checked, and that reaches its own subscriptions only."""

    iserver: "BoundedInternalServer"
    mode = ua.MessageSecurityMode.None_
    """Of its channel; one that is signed is so by the key of a trusted certificate"""

    @property
    def address(self) -> str:
        """Address of the client."""
        return _host(self.name)

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


class BoundedProcessor(UaProcessor):
    """Processes the messages of a connection, once it has a secure channel."""

    iserver: BoundedInternalServer

    def open_secure_channel(self, algohdr: Any, seqhdr: Any, body: Any) -> None:
        """Open a channel, for a trusted certificate only."""
        policy = self._connection.security_policy
        if policy.URI != NO_SECURITY:
            try:
                self.iserver.access.check_client(policy.peer_certificate)
            except ClientRefusedError as err:
                self.iserver.access.tell(_host(self.name), err)
                raise
        super().open_secure_channel(algohdr, seqhdr, body)

    async def _process_message(
        self, typeid: ua.NodeId, requesthdr: ua.RequestHeader, seqhdr: Any, body: Any
    ) -> Any:
        if not self._connection.is_open():
            raise ServiceError(ua.StatusCodes.BadSecureChannelIdInvalid)
        if isinstance(self.session, BoundedSession):
            self.session.mode = self._connection.security_policy.Mode
        return await super()._process_message(typeid, requesthdr, seqhdr, body)

    def _should_close_session_on_transport_loss(self) -> bool:
        return True  # no other connection could go on with it

    def send_response(
        self, requesthandle: int, seqhdr: Any, response: Any, msgtype: Any = ua.MessageType.SecureMessage
    ) -> None:
        """Send an answer, unless the client reads none."""
        super().send_response(requesthandle, seqhdr, response, msgtype)
        if self._transport.get_write_buffer_size() > MAX_UNREAD_BYTES:
            self.iserver.access.tell(_host(self.name), "reads no answers: its connection is closed")
            self._transport.abort()


class BoundedProtocol(OPCUAProtocol):
    """A connection that is closed when it sends too much, or what is not understood."""

    iserver: BoundedInternalServer
    processor: UaProcessor | None
    transport: asyncio.Transport | None
    _buffer: bytes

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Accept a connection; if there are too many, the oldest that may not read makes room."""
        if len(self.clients) >= self.iserver.max_connections:
            waiting = (each for each in self.clients if not each.may_read())
            if (oldest := next(waiting, None)) is not None and oldest.transport is not None:
                self.clients.remove(oldest)
                oldest.transport.abort()
        super().connection_made(transport)
        if self.processor is not None and self.transport is not None:
            self.processor = BoundedProcessor(self.iserver, self.transport, self.limits)
            self.processor.set_policies(self.policies)

    def may_read(self) -> bool:
        """True once its session is activated."""
        session = None if self.processor is None else self.processor.session
        return session is not None and session.is_activated()

    def data_received(self, data: bytes) -> None:
        """Take bytes up to the size of the largest chunk, beyond what is processed."""
        super().data_received(data)
        if len(self._buffer) > BUFFER_BYTES and self.transport is not None:
            self.iserver.access.tell(_host(self.peer_name), "sends a chunk that is too large")
            self._buffer = b""
            self.transport.abort()

    async def _process_one_msg(self, header: Any, buf: Any) -> Any:
        await asyncio.sleep(0)  # other connections have their turn
        try:
            is_to_go_on = await super()._process_one_msg(header, buf)
        except Exception as err:  # noqa: BLE001 - whatever a stranger's bytes do to the library
            code = getattr(err, "code", ua.StatusCodes.BadTcpInternalError)
            if not isinstance(err, ClientRefusedError):
                self.iserver.access.tell(_host(self.peer_name), f"sends what is not understood: {err!r}")
            if self.transport is not None and not self.transport.is_closing():
                error = ua.ErrorMessage(ua.StatusCode(code), "")
                self.transport.write(uatcp_to_binary(ua.MessageType.Error, error))
                self.transport.close()
            is_to_go_on = False
        if not is_to_go_on and self.transport is not None:  # who reads nothing would never be rid of
            asyncio.get_running_loop().call_later(LINGER_S, self.transport.abort)
        return is_to_go_on


class BoundedBinaryServer(BinaryServer):
    """Listens for bounded connections."""

    def _make_protocol(self) -> OPCUAProtocol:
        return BoundedProtocol(
            iserver=self.iserver,
            policies=self._policies,
            clients=self.clients,
            closing_tasks=self.closing_tasks,
            limits=self.limits,
        )


class BoundedServer(Server):
    """asyncua's server, with bounds; `access` says who may do what, `methods` has all methods."""

    iserver: BoundedInternalServer

    def __init__(self, access: Access, methods: MethodTable) -> None:
        super().__init__(iserver=BoundedInternalServer(access, methods))
        self.application_type = ua.ApplicationType.Server
        self.limits = BoundedLimits(
            BUFFER_BYTES, BUFFER_BYTES, MAX_MESSAGE_BYTES // BUFFER_BYTES + 1, MAX_MESSAGE_BYTES
        )
        self.set_security_policy(
            [
                ua.SecurityPolicyType.NoSecurity,
                ua.SecurityPolicyType.Basic256Sha256_Sign,
                ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
            ],
            permission_ruleset=ServedServices(),
        )

    async def init(self, shelf_file: Path | None = None) -> None:
        """Build the address space of OPC UA itself, which says what one request may ask for."""
        await super().init(shelf_file)
        for name, most in OPERATION_LIMITS.items():
            number = getattr(ua.ObjectIds, f"Server_ServerCapabilities_OperationLimits_{name}")
            await self.get_node(ua.NodeId(number)).write_value(ua.Variant(most, ua.VariantType.UInt32))

    async def start(self) -> None:
        """Listen; raise `OSError` if that cannot be."""
        await self._setup_server_nodes()
        for endpoint in self.iserver.endpoints:
            if endpoint.SecurityMode == ua.MessageSecurityMode.None_:  # only anonymous ones, of this machine
                endpoint.UserIdentityTokens = [
                    token
                    for token in endpoint.UserIdentityTokens
                    if token.TokenType == ua.UserTokenType.Anonymous
                ]
        await self.iserver.start()
        self.bserver = BoundedBinaryServer(
            self.iserver, self.endpoint.hostname, self.endpoint.port, self.limits
        )
        self.bserver.set_policies(self._policies)
        try:
            await self.bserver.start()
        except OSError:
            await self.iserver.stop()
            raise

    async def emit(self, event: BaseEvent, subscription_id: int | None = None) -> None:
        """Send an event to all subscriptions, or to one; a filter that fails ends its own subscription."""
        event.ReceiveTime = now_utc()
        event.Time = event.Time or event.ReceiveTime
        event.EventId = event.EventId or uuid.uuid4().bytes
        service = self.iserver.subscription_service
        for each, subscription in list(service.subscriptions.items()):
            if subscription_id in (None, each):
                try:
                    await subscription.monitored_item_srv.trigger_event(event)
                except Exception:
                    log.exception("subscription %d cannot take an event, and is deleted", each)
                    await service.delete_subscriptions([each])


def _host(peer: object) -> str:
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
    except Exception as err:
        raise ServiceError(ua.StatusCodes.BadEventFilterInvalid) from err
    # a tree of elements is evaluated in as many steps; one that is referred to twice, and that again, in 2^n
    seen: set[int] = set()
    for place, element in enumerate(wanted.WhereClause.Elements):
        for operand in element.FilterOperands:
            if isinstance(operand, ua.ElementOperand):
                if operand.Index <= place or operand.Index in seen:
                    raise ServiceError(ua.StatusCodes.BadEventFilterInvalid)
                seen.add(operand.Index)
