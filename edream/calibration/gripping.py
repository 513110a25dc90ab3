"""Joints that hold things: their servo's numbers, from the stretches of the recordings in which nothing is held.

What a hand holds stops its finger, which would teach a fit that the servo is weak; and a policy sees the finger, so that one which
lags otherwise than the robot's tells it another moment of its motion.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from edream.calibration.data import thinned
from edream.calibration.settings import Limits, SpaceSettings, simulated_robot
from edream.calibration.worth import worth_of
from edream.core.effect import holds_position
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.sim.beginning import beginning
from edream.sim.emit import emit
from edream.sim.objective import Objective, rms
from edream.sim.polish import finish, polish_in_stages
from edream.sim.robot import RobotModel
from edream.sim.window import Window

LAWS = ("servo_gain", "viscous", "coulomb", "armature")
SHORT = 0.06  # of a joint's travel in the recordings: standing so far from its command, it is stopped by something
CREEPING = 0.08  # of that travel, in a second: no faster than this it stands
LASTING = 0.2  # s that it stands so at least
HALF = 0.5  # of the way to a thing, on which most are not yet touched
SHORTEST = 0.3  # s of a stretch that is worth replaying
ODD = 3.0  # times the median stretch's error: there something was touched earlier
ENOUGH = 120.0  # s of free motion that are fitted
BELIEVED = 0.3  # standard deviation of the logarithm of kp about the published one: free motion hardly tells how strong it is
LEAST = 0.1  # of the travel that a joint must move freely, for its numbers to be told


@dataclass(frozen=True, eq=False)
class Gripped:
    """A robot whose gripping joints move as they were recorded where they held nothing.

    Attributes:
        robot: the robot with those numbers.
        joints: joint -> free_s (seconds of free motion that were fitted), rmse_before and rmse_after (error there, in the
            joint's unit) and parameters; empty parameters where it hardly moved freely.
    """

    robot: RobotModel
    joints: dict[str, dict[str, Any]]


def gripping(robot: RobotModel, joints: Sequence[str], episodes: Sequence[Episode]) -> Gripped:
    """Fit each gripping joint alone, on what it does while it holds nothing.

    Args:
        robot: as published.
        joints: those that hold things.
        episodes: the motions that may teach.

    Raises:
        EdreamError: the robot has no such joint, or its servo holds no position.
    """
    told: dict[str, dict[str, Any]] = {}
    for joint in joints:
        column = robot.joint_index(joint)
        if not holds_position(robot.model, joint):
            raise EdreamError(f"robot.grips names {joint}, whose servo holds no position; leave it out, and it stays as published.")
        windows = _enough(episodes, column)
        if not windows:
            told[joint] = {"free_s": 0.0, "rmse_before": None, "rmse_after": None, "parameters": {}}
            continue
        robot, told[joint] = _fitted(robot, joint, column, windows, episodes)
    return Gripped(robot, told)


def _enough(episodes: Sequence[Episode], column: int) -> list[Window]:
    """Stretches in which a joint moves far enough to tell its numbers, half of its ways to things among them only if it must be."""
    reach = travel(episodes, column)
    for share in (0.0, HALF):
        windows = [window for episode in episodes for window in free_stretches(episode, column, reach, share)]
        if reach and max((float(np.ptp(window.measured[:, column])) for window in windows), default=0.0) >= LEAST * reach:
            return thinned(windows, ENOUGH)
    return []


def _fitted(
    robot: RobotModel, joint: str, column: int, windows: Sequence[Window], episodes: Sequence[Episode]
) -> tuple[RobotModel, dict[str, Any]]:
    simulated = simulated_robot(robot, _laws(joint), episodes)
    objective = Objective(simulated, windows, np.arange(len(robot.joints)) == column)
    first, _ = polish_in_stages(objective, beginning(objective), 12, 10)
    windows = _usual(objective, first.values)
    objective = Objective(simulated, windows, objective.joints)
    before = objective.residuals(simulated.space.start())[0]
    end = finish(objective, first.values, 10)
    worth = worth_of(objective, end.values, end.residual, end.jacobian)
    row = {
        "free_s": float(sum(window.times[-1] for window in windows)),
        "rmse_before": rms(before),
        "rmse_after": rms(end.residual),
        "parameters": {name: asdict(estimate) for name, estimate in worth.estimates.items()},
    }
    return with_numbers(robot, {joint: row}), row


def _usual(objective: Objective, values: np.ndarray) -> list[Window]:
    """The windows that are not much worse than the median one."""
    errors = [rms(part) for part in objective.per_window(objective.residuals(values)[0])]
    return [window for window, one in zip(objective.windows, errors, strict=True) if one <= ODD * np.median(errors)]


def with_numbers(robot: RobotModel, joints: Mapping[str, Mapping[str, Any]]) -> RobotModel:
    """A robot with the numbers of its gripping joints, as `Gripped.joints` has them."""
    for joint, row in joints.items():
        if row["parameters"]:
            simulated = simulated_robot(robot, _laws(joint))
            robot = replace(robot, mjcf=emit(simulated, {n: one["value"] for n, one in row["parameters"].items()}).mjcf)
    return robot


def _laws(joint: str) -> SpaceSettings:
    believed = {"servo_gain.kp": Limits(spread=BELIEVED)}
    return SpaceSettings(effects=tuple(f"{law}@{joint}" for law in LAWS), joints=(joint,), limits=believed)


def free_stretches(episode: Episode, column: int, reach: float, share: float = 0.0) -> list[Window]:
    """The stretches of a recording in which a joint holds nothing, each from a measured state.

    A joint that stands short of its command is held. It may have touched the thing on its way there from where it last stood, and
    is free again when its command lets it go, at rest. Nothing is known of things that it holds with its command hardly past them.

    Args:
        column: of the joint.
        reach: how far the joint travels in all recordings [rad or m].
        share: of that way to a thing, on which it is taken not to have touched it yet.
    """
    times, position = episode.times, episode.position[:, column]
    short_of = position - episode.command[episode.in_force(times), column]
    short, still, told = _standing(episode, column, reach)
    there, held = np.flatnonzero(~short & still & told), np.zeros(len(times), bool)
    for first, last in _runs(short & still):
        if times[last] - times[first] >= LASTING:
            stood = int(np.append(0, there[there < first])[-1])
            on_its_way = np.abs(position[stood:first] - position[first]) > (1.0 - share) * abs(position[stood] - position[first])
            let_go = np.flatnonzero(short_of[first:] * short_of[first] <= 0.0)
            held[stood + _leading(on_its_way) : first + let_go[0] if len(let_go) else len(times)] = True
    return [_alone(episode, first, last) for first, last in _runs(~held) if times[last] - times[first] >= SHORTEST]


def _leading(rows: np.ndarray) -> int:
    """How many rows are true before the first that is not."""
    return int(np.argmin(np.append(rows, False)))


def _alone(episode: Episode, first: int, last: int) -> Window:
    """A stretch as a motion of its own: one that sets out from rest there is known to."""
    clock, rows = episode.times[first], slice(first, last + 1)
    alone = replace(
        episode,
        times=episode.times[rows] - clock,
        position=episode.position[rows],
        command_times=episode.command_times - clock,
        velocity=None,
        effort=None,
        videos={},
        signals={},
    )
    return Window(alone, 0, last - first)


def travel(episodes: Sequence[Episode], column: int) -> float:
    """How far a joint's commands reach over all recordings [rad or m]."""
    return float(np.ptp(np.concatenate([episode.command[:, column] for episode in episodes])))


def _standing(episode: Episode, column: int, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows in which a joint is short of its command, in which it stands, and in which its command has stood, (T,) bool each."""
    times, position = episode.times, episode.position[:, column]
    command, before = (episode.command[episode.in_force(clock), column] for clock in (times, times - LASTING))
    speed = np.abs(np.diff(position) / np.diff(times))
    slow = np.minimum(np.append(speed, speed[-1:]), np.append(speed[:1], speed))  # on either side, so that a stop begins with it
    return np.abs(position - command) > SHORT * reach, slow < CREEPING * reach, np.abs(command - before) < SHORT * reach


def _runs(rows: np.ndarray) -> list[tuple[int, int]]:
    """First and last row of each run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]]).astype(int)))
    return [(int(first), int(last) - 1) for first, last in zip(edges[::2], edges[1::2], strict=True)]
