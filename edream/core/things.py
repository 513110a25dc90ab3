"""Everyday things, built of primitive shapes."""

from collections.abc import Sequence

import numpy as np

from edream.core.scene import SceneObject
from edream.core.task import UPRIGHT, Part, Thing, about_z

Colour = tuple[float, float, float]
WALL = 0.002  # half thickness of a cup's wall [m]; thinner ones let the fingers through
FACETS = 10


def cup(
    name: str, place: Sequence[float] | np.ndarray, radius: float, height: float, mass: float, friction: float, colour: Colour
) -> Thing:
    """An open cup that stands on the table: facets around a floor. Its origin is its middle.

    Args:
        place: x, y [m].
        radius: outer radius [m].
        height: of the cup [m].
    """
    angles = 2.0 * np.pi * (np.arange(FACETS) + 0.5) / FACETS
    # apothem, so that the facets' outer faces touch the radius
    reach, width = radius - WALL, radius * np.tan(np.pi / FACETS)
    walls = [Part("box", (WALL, width, height / 2 - WALL), (reach * np.cos(a), reach * np.sin(a), WALL), _quat(a)) for a in angles]
    floor = Part("cylinder", (radius - WALL, 2 * WALL), (0.0, 0.0, -height / 2 + 2 * WALL))
    proxy = SceneObject(name, "cylinder", (radius, height / 2), colour)
    pose = np.concatenate([place, [height / 2], UPRIGHT])
    return Thing(name, (floor, *walls), proxy, mass, friction, pose)


def bar(
    name: str,
    place: Sequence[float] | np.ndarray,
    size: Sequence[float],
    angle: float,
    mass: float,
    friction: float,
    colour: Colour,
) -> Thing:
    """A box that lies on the table, turned by `angle` about the vertical [rad]; `size` holds half sizes [m]."""
    half = (float(size[0]), float(size[1]), float(size[2]))
    pose = np.concatenate([place, [half[2]], about_z(angle)])
    return Thing(name, (Part("box", half),), SceneObject(name, "box", half, colour), mass, friction, pose)


def tray(
    name: str,
    place: Sequence[float] | np.ndarray,
    size: Sequence[float],
    angle: float,
    mass: float,
    friction: float,
    colour: Colour,
) -> Thing:
    """An open box; `size` holds outer half sizes [m]."""
    x, y, z = (float(one) for one in size)
    wall = 0.003
    parts = (
        Part("box", (x, y, wall), (0.0, 0.0, wall - z)),
        *(Part("box", (wall, y, z - wall), (side * (x - wall), 0.0, wall)) for side in (-1.0, 1.0)),
        *(Part("box", (x, wall, z - wall), (0.0, side * (y - wall), wall)) for side in (-1.0, 1.0)),
    )
    pose = np.concatenate([place, [z], about_z(angle)])
    return Thing(name, parts, SceneObject(name, "box", (x, y, z), colour), mass, friction, pose)


def mat(name: str, place: Sequence[float] | np.ndarray, radius: float, colour: Colour) -> Thing:
    """A thin round mat, glued to the table."""
    part = Part("cylinder", (radius, 0.0015))
    proxy = SceneObject(name, "cylinder", (radius, 0.0015), colour)
    return Thing(name, (part,), proxy, 0.05, 0.8, np.concatenate([place, [0.0015], UPRIGHT]), fixed=True)


def _quat(angle: float) -> tuple[float, float, float, float]:
    w, x, y, z = about_z(angle)
    return float(w), float(x), float(y), float(z)
