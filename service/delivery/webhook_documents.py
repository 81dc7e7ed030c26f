"""Endpoints of webhooks as REST shows them: without their secrets."""

from service.base.schema import OptionalTime, served
from service.store.events import EventType


@served
class WebhookDocument:
    """An endpoint that events are posted to, and its progress; without its secrets."""

    name: str
    """As it is configured"""
    is_of_configuration: bool
    """True: the file of settings alone changes it; false: it was made over REST"""
    n_secrets: int
    """Secrets that each message is signed with: 2 during a rotation"""
    url: str
    """Scheme, host and first part of the path: the rest may be secret"""
    events: tuple[EventType, ...]
    """Types of the events that it gets"""
    after: int
    """`seq` of the last event that it has taken"""
    waiting: int
    """Events that wait to be posted to it"""
    attempts: int
    """Failed ones of the next event"""
    failing_since: OptionalTime
    """First of these, RFC 3339 UTC; null without any"""
    next_attempt_at: OptionalTime
    """When it is tried again; null: at once, or it is disabled"""
    last_problem: str | None
    """Why the latest attempt failed; null if it did not"""
    last_taken_at: OptionalTime
    """When it took a message last; null before the first"""
    disabled_at: OptionalTime
    """Not null: it gets nothing until it is enabled"""


@served
class DefinedWebhook(WebhookDocument):
    """An endpoint that was made or changed over REST."""

    secret: str | None
    """The secret that was made for it, shown this once; null when none was made"""
