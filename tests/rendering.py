"""Whether this machine renders; tests that must see something skip where it does not."""

from functools import cache
from pathlib import Path

import numpy as np

from edream.core.camera import Camera, looking_at, pinhole
from edream.core.errors import EdreamError
from edream.sim.camera import SimulationCamera
from edream.sim.robot import RobotModel, load_robot

ROBOTS = Path(__file__).resolve().parent.parent / "edream" / "robots"


def pan_tilt() -> RobotModel:
    """A small robot of plain shapes."""
    return load_robot(ROBOTS / "pan_tilt.xml", "pan_tilt", "ee")


def camera_on(size: int = 48) -> Camera:
    """A camera that sees all of it."""
    return pinhole(size, size, 0.8, looking_at(np.array([0.45, -0.35, 0.3]), np.array([0.0, 0.0, 0.1])))


@cache
def why_not() -> str | None:
    """Why this machine cannot render, or None where it can."""
    try:
        SimulationCamera(pan_tilt(), camera_on(16)).close()
    except EdreamError as error:
        return str(error)
    return None
