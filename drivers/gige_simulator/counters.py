"""What a camera counts about itself, so that a test can demand that nothing is unaccounted for.

edges = triggers + missed + debounced + unseen, and, once everything is sent,
exposures = frames + torn + swallowed + unexposed + aborted.
"""

from dataclasses import dataclass


@dataclass(slots=True)
class SensorTally:
    """What came in and was exposed; kept under the sensor's lock."""

    edges: int = 0
    heard: int = 0
    triggers: int = 0
    missed: int = 0
    debounced: int = 0
    unseen: int = 0
    exposures: int = 0
    started: int = 0
    unexposed: int = 0
    swallowed: int = 0
    aborted: int = 0


@dataclass(slots=True)
class WireTally:
    """What went out; kept under the stream channel's lock."""

    frames: int = 0
    torn: int = 0
    packets: int = 0
    dropped: int = 0
    resent: int = 0
    unavailable: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Counters:
    """Since the camera was made: a power cycle does not clear them."""

    edges: int  # rising edges at the lines, software triggers, actions, and what else is listened to
    heard: int  # of them, by a trigger that is on
    triggers: int  # accepted edges
    missed: int  # not acquiring, not listened to, or still exposing the last one
    debounced: int
    unseen: int  # by fault
    exposures: int  # due: triggered, or the next one of a free run
    started: int  # of them
    unexposed: int  # the image source had nothing to show: not sent
    swallowed: int  # by fault: not sent
    aborted: int  # acquisition or power ended before it was sent
    frames: int  # every packet left, at first or when resent
    torn: int  # a packet never left (yet)
    packets: int  # on the wire, resent and repeated ones and refusals to resend included
    dropped: int  # taken by a fault, the pulled cable or the uplink instead
    resent: int
    unavailable: int  # refusals to resend
    heartbeats: int  # readings of the control privilege by its owner
    actions: int  # with our keys
