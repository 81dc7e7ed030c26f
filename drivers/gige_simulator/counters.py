"""Counters of a simulated camera, with which tests verify that every edge and exposure is accounted for.

edges = triggers + missed + debounced + unseen, and, once everything is sent,
exposures = frames + torn + swallowed + unexposed + aborted.
"""

from dataclasses import dataclass


@dataclass(slots=True)
class SensorTally:
    """Counters of edges and exposures, kept under the sensor's lock; `Counters` describes them."""

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
    """Counters of frames and packets, kept under the stream channel's lock; `Counters` describes them."""

    frames: int = 0
    torn: int = 0
    packets: int = 0
    dropped: int = 0
    resent: int = 0
    unavailable: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Counters:
    """All counters since the camera was made; a power cycle does not clear them."""

    edges: int  # rising edges at the lines, other edges that a trigger listens to, software triggers, actions
    heard: int  # edges that a trigger which is on listens to
    triggers: int  # accepted edges
    missed: int  # edges while not acquiring, with no trigger listening, or while the last exposure goes on
    debounced: int  # edges dropped by the debouncer of the line
    unseen: int  # edges dropped by fault
    exposures: int  # planned: triggered, or the next one of a free run
    started: int  # exposures begun
    unexposed: int  # not sent, because the image source had no image
    swallowed: int  # not sent, by fault
    aborted: int  # not sent, because acquisition or power ended before
    frames: int  # of which every packet left, at first or when resent
    torn: int  # frames of which a packet has not left (yet)
    packets: int  # on the wire, including resent and repeated ones and refusals to resend
    dropped: int  # packets not sent because of a fault, the pulled cable or the uplink
    resent: int  # packets
    unavailable: int  # refusals to resend
    heartbeats: int  # readings of the control privilege by its owner
    actions: int  # action commands with the camera's keys
    blinks: int  # how often a host lit its lamp
