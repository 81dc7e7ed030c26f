"""Connections that are closed when they send too much, read nothing, or ask without a secure channel.

asyncua leaves to its user what is added here: messages without a secure channel, answers that nobody reads, and bodies
of gigabytes.
"""

import asyncio
from typing import Any

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import ServiceError
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import uatcp_to_binary

from service.bridge.opcua.access import ClientRefusedError
from service.bridge.opcua.sessions import BoundedInternalServer, BoundedSession, host_of

MAX_MESSAGE_BYTES = 1_000_000
MAX_UNREAD_BYTES = 8_000_000
"""Answers that a client has not read, before its connection is closed."""
LINGER_S = 2.0
"""Time to read the last answer in, once a connection is closed."""
BUFFER_BYTES, LEAST_BUFFER_BYTES = 65_535, 8192
"""Largest chunk, and the least that a client must be able to take (OPC 10000-6, 7.1.2.3)."""
NO_SECURITY = "http://opcfoundation.org/UA/SecurityPolicy#None"


class BoundedLimits(TransportLimits):
    """Sizes of messages; a client that takes only tiny chunks would have each answer cut into thousands."""

    def create_acknowledge_and_set_limits(self, msg: ua.Hello) -> ua.Acknowledge:
        """Agree on sizes with a client; raise `ServiceError` if its own are too small."""
        if min(msg.ReceiveBufferSize, msg.SendBufferSize) < LEAST_BUFFER_BYTES:
            raise ServiceError(ua.StatusCodes.BadConnectionRejected)
        return super().create_acknowledge_and_set_limits(msg)


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
                self.iserver.access.tell(host_of(self.name), err)
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
            self.iserver.access.tell(host_of(self.name), "reads no answers: its connection is closed")
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
            self.iserver.access.tell(host_of(self.peer_name), "sends a chunk that is too large")
            self._buffer = b""
            self.transport.abort()

    async def _process_one_msg(self, header: Any, buf: Any) -> Any:
        await asyncio.sleep(0)  # other connections have their turn
        try:
            is_to_go_on = await super()._process_one_msg(header, buf)
        except Exception as err:  # noqa: BLE001 - whatever a stranger's bytes do to the library
            code = getattr(err, "code", ua.StatusCodes.BadTcpInternalError)
            if not isinstance(err, ClientRefusedError):
                self.iserver.access.tell(host_of(self.peer_name), f"sends what is not understood: {err!r}")
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
