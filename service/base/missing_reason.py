"""Why a bundle lacks a frame."""

from enum import StrEnum


class MissingReason(StrEnum):
    """Why a bundle lacks a camera's frame, as far as the service decides it; drivers give reasons of their own."""

    NO_FRAME = "no_frame"
    """No frame came from the camera until the deadline."""
    CAMERA_LOST = "camera_lost"
    """The camera does not answer."""
    AMBIGUOUS = "ambiguous"
    """Two different frames came for one trigger."""
    OTHER_EXPOSURE = "other_exposure"
    """By its camera's clock the frame was exposed for another trigger."""
    FROZEN = "frozen"
    """The image equals the camera's previous one bit for bit, which no sensor does twice."""
    DEAD_TIME = "dead_time"
    """The trigger followed another within the gate's dead time; the frames belong to the first."""
    DISARMED = "disarmed"
    """The rig was disarmed before the frame came."""
    STONE_PASSED = "stone_passed"
    """The empty rig was exposed while a stone fell."""
    UNSEEN = "unseen"
    """The gate counted the trigger and did not announce it, and no camera exposed."""
    DOWN = "down"
    """The gate counted the trigger while no daemon ran."""
