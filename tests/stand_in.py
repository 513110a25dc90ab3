"""Recordings of the robot that stands in for a real one, as a diagnosis gets them."""

from edream.core.episode import Episode
from edream.reality.recorder import Recorder, make_recordings
from edream.reality.truth import Truth
from edream.sim.robot import RobotModel


def episodes_of(robot: RobotModel, truth: Truth, seed: int, motions: int = 6, seconds: float = 5.0) -> list[Episode]:
    """So many free motions of so many seconds each, with the usual recorder's noise."""
    made = make_recordings(robot, truth, seed, motions, seconds, Recorder())
    return [Episode(r.name, robot.joints, r.times, r.position, r.command_times, r.command) for r in made]
