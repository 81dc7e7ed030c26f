"""Soft dark spots of a wall far out of focus: screws, vents and smudges.

A spot's grey is that of its middle as a lens at F2.0 shows it: what is smaller than the blur's disc is darker in truth.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Directions, Floats, Values, Vector

N_SPOTS = 760
"""About eight in a field of view, with vents of several slots each."""
GREYS = (0.3, 0.75)
"""Grey of a spot's middle, relative to the wall around it."""
BLUR_RADIUS_MM = 6.25
"""Radius of the blur's disc on the far wall: that of the aperture of a lens of 25 mm at F2.0, focused halfway."""
SCREW_RADII_MM, SMUDGE_RADII_MM = (4.5, 8.0), (8.0, 20.0)
SCREW_SOFTNESS_MM = 0.8
SMUDGE_SOFTNESS = 0.8
"""Width of a smudge's border, relative to its radius."""
VENT_SLOTS, SLOT_RADIUS_MM, SLOT_SPACING_MM = 4, 4.5, 7.0
SHARES = (0.5, 0.2)
"""Shares of screws and of vents among the spots; the rest are smudges."""
DARKEST = 0.03
"""Least reflectance, relative to the wall."""
ONE_SPOT_RADIUS_MM, ONE_SPOT_GREY = 9.0, 0.58


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spots:
    """Discs with soft borders on the wall."""

    directions: Directions  # from the origin
    radii_mm: Values
    softness_mm: Values  # width of the border
    shares: Values  # reflectance of the middle, relative to the wall

    def shares_at(self, directions: Directions, wall_radius_mm: float) -> Values:
        """Return the reflectance (N,) in directions (N, 3) relative to a wall without spots; the darkest counts."""
        result = np.ones(len(directions))
        middle = directions.mean(axis=0)
        middle /= np.linalg.norm(middle)
        reach_mm = self.radii_mm + self.softness_mm / 2
        field = np.arccos(np.clip((directions @ middle).min(), -1, 1))
        away = np.arccos(np.clip(self.directions @ middle, -1, 1))
        for i in np.flatnonzero(away < field + reach_mm / wall_radius_mm):
            near = np.flatnonzero(directions @ self.directions[i] > np.cos(reach_mm[i] / wall_radius_mm))
            chords = np.linalg.norm(directions[near] - self.directions[i], axis=1)
            inside_mm = self.radii_mm[i] - wall_radius_mm * chords
            depth = np.clip(inside_mm / self.softness_mm[i] + 0.5, 0, 1)
            result[near] = np.minimum(result[near], 1 - (1 - self.shares[i]) * depth)
        return result


def many_spots(wall_radius_mm: float, rng: np.random.Generator) -> Spots:
    """Return screws, vents and smudges all over a wall."""
    centers = scattered_directions(N_SPOTS, rng)
    kinds = rng.choice(3, size=N_SPOTS, p=[*SHARES, 1 - sum(SHARES)])
    parts = []
    for center, kind in zip(centers, kinds, strict=True):
        grey = rng.uniform(*GREYS)
        if kind == 0:
            parts.append(_disc(center, rng.uniform(*SCREW_RADII_MM), SCREW_SOFTNESS_MM, grey))
        elif kind == 1:
            along = np.cross(center, rng.normal(size=3))
            along *= SLOT_SPACING_MM / wall_radius_mm / np.linalg.norm(along)
            places = center + (np.arange(VENT_SLOTS) - (VENT_SLOTS - 1) / 2)[:, None] * along
            places /= np.linalg.norm(places, axis=1, keepdims=True)
            parts += [_disc(place, SLOT_RADIUS_MM, SCREW_SOFTNESS_MM, grey) for place in places]
        else:
            radius_mm = rng.uniform(*SMUDGE_RADII_MM)
            parts.append(_disc(center, radius_mm, SMUDGE_SOFTNESS * radius_mm, grey))
    return _joined(np.array(parts))


def spots_at(directions: Directions) -> Spots:
    """Return equal spots in directions (N, 3), wider than the blur's disc."""
    return _joined(
        np.array([_disc(each, ONE_SPOT_RADIUS_MM, SCREW_SOFTNESS_MM, ONE_SPOT_GREY) for each in directions])
    )


def _disc(direction: Vector, radius_mm: float, softness_mm: float, grey: float) -> Values:
    """Return direction, radius, softness and reflectance (6,) of a spot whose middle looks so grey."""
    filled = min(1.0, radius_mm / BLUR_RADIUS_MM) ** 2  # of the blur's disc
    share = max(1 - (1 - grey) / filled, DARKEST)
    return np.array([*direction, radius_mm, softness_mm, share])


def _joined(rows: Floats) -> Spots:
    return Spots(directions=rows[:, :3], radii_mm=rows[:, 3], softness_mm=rows[:, 4], shares=rows[:, 5])


def scattered_directions(count: int, rng: np.random.Generator) -> Directions:
    """Return directions (count, 3) spread evenly (a Fibonacci spiral) and displaced by half their spacing."""
    index = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * index / max(count, 1), np.pi * (1 + np.sqrt(5)) * index
    spiral = np.column_stack([np.sqrt(1 - z**2) * np.cos(azimuth), np.sqrt(1 - z**2) * np.sin(azimuth), z])
    shaken = spiral + rng.normal(0, 0.5 * np.sqrt(4 * np.pi / max(count, 1)) / 2, size=(count, 3))
    return np.asarray(shaken / np.linalg.norm(shaken, axis=1, keepdims=True))
