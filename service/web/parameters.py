"""Parameters that routes of several rooms take."""

from typing import Annotated

from fastapi import Path

CameraName = Annotated[
    str, Path(pattern=r"^[A-Za-z0-9_-]{1,64}$", description="Place of the camera in the rig, such as `c01`")
]
