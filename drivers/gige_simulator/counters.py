"""What a camera counts about itself, so that a test can demand that nothing is unaccounted for."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Counters:
    """Since the camera was made: a power cycle does not clear them.

    edges = triggers + missed + debounced + unseen, and
    exposures = frames + torn + swallowed + unexposed + aborted once everything is sent.
    """

    edges: int = 0  # rising edges at the lines, software triggers, actions, and what else is listened to
    triggers: int = 0  # accepted edges
    missed: int = 0  # not acquiring, not listened to, or still exposing the last one
    debounced: int = 0
    unseen: int = 0  # by fault
    exposures: int = 0  # due: triggered, or the next one of a free run
    unexposed: int = 0  # the image source had nothing to show: not sent
    swallowed: int = 0  # by fault: not sent
    aborted: int = 0  # acquisition or power ended before it was sent
    frames: int = 0  # every packet left, at first or when resent
    torn: int = 0  # a packet never left (yet)
    packets: int = 0  # on the wire, resent and repeated ones and refusals to resend included
    dropped: int = 0  # taken by a fault, the pulled cable or the uplink instead
    resent: int = 0
    unavailable: int = 0  # refusals to resend
    heartbeats: int = 0  # readings of the control privilege by its owner
    actions: int = 0  # with our keys
