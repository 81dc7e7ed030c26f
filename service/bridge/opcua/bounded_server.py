"""An OPC UA server that a slow or hostile client can neither stop, nor fill, nor reach what is another's."""

import logging
import uuid
from pathlib import Path

from asyncua import Server, ua
from asyncua.common.event_objects import BaseEvent
from asyncua.crypto.permission_rules import PermissionRuleset, User

from service.bridge.opcua.access import Access
from service.bridge.opcua.certificates import now_utc
from service.bridge.opcua.connections import (
    BUFFER_BYTES,
    MAX_MESSAGE_BYTES,
    BoundedBinaryServer,
    BoundedLimits,
)
from service.bridge.opcua.methods import MethodTable
from service.bridge.opcua.sessions import (
    MAX_BROWSED,
    MAX_CALLS,
    MAX_ITEMS_OF_SESSION,
    MAX_NODES,
    BoundedInternalServer,
)

log = logging.getLogger(__name__)

OPERATION_LIMITS = {
    "MaxNodesPerRead": MAX_NODES,
    "MaxNodesPerWrite": MAX_NODES,
    "MaxNodesPerBrowse": MAX_BROWSED,
    "MaxNodesPerMethodCall": MAX_CALLS,
    "MaxNodesPerTranslateBrowsePathsToNodeIds": MAX_NODES,
    "MaxNodesPerRegisterNodes": MAX_NODES,
    "MaxMonitoredItemsPerCall": MAX_ITEMS_OF_SESSION,
}
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


class ServedServices(PermissionRuleset):
    """Refuses all services but those in `SERVICES`."""

    def check_validity(self, user: User, action_type: ua.NodeId, body: object) -> bool:
        """Return False for a service that is not served."""
        return action_type in SERVICES


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
                except Exception:  # of a filter by a client: its own subscription alone
                    log.exception("subscription %d cannot take an event, and is deleted", each)
                    await service.delete_subscriptions([each])
