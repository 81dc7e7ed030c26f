"""The arrays that pass between modules: each name tells element type and shape.

N counts whatever the argument is about, H and W are the rows and columns of an image. Shapes that occur in
one module alone are given in its docstrings, with `Floats` or `Singles` as the type.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""Double precision, any shape."""
Singles = NDArray[np.float32]
"""Single precision, any shape."""

Vector = Annotated[Floats, "(3,)"]
"""A point in mm or a direction, in the frame that its name gives."""
Vector2 = Annotated[Floats, "(2,)"]
"""A pixel (u, v), or another pair of image coordinates."""
Matrix33 = Annotated[Floats, "(3, 3)"]
"""A rotation or an intrinsic matrix."""
Values = Annotated[Floats, "(N,)"]
PointsUV = Annotated[Floats, "(N, 2)"]
"""Pixels (u, v) = (column, row), centres on integers; or normalized image coordinates (x/z, y/z)."""
PointsMM = Annotated[Floats, "(N, 3)"]
"""Points in mm."""
Directions = Annotated[Floats, "(N, 3)"]
"""Unit vectors."""

Faces = Annotated[NDArray[np.int64], "(N, 3)"]
"""Triangles: indices of their vertices, counter-clockwise seen from outside."""
Indices = Annotated[NDArray[np.int64], "(N,)"]
Indices32 = NDArray[np.int32]
"""Indices of vertices, facets or points in the compiled loops over hulls and meshes, any shape."""
Flags = Annotated[NDArray[np.bool_], "(N,)"]

GreyImage = Annotated[NDArray[np.uint8], "(H, W)"]
"""Grey levels, or labels of pixels."""
FloatImage = Annotated[Singles, "(H, W)"]
Mask = Annotated[NDArray[np.bool_], "(H, W)"]

Greys = Annotated[NDArray[np.uint8], "(N,)"]
"""Grey levels of vertices, 0 to 255."""
