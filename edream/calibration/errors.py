"""Replay errors of a parameter set, split every way a reader may ask for."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from edream.calibration.pose import Chain, pose_error
from edream.core.effect import holds_position
from edream.core.episode import Episode
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from edream.sim.window import Window, split, whole

HORIZONS = (0.1, 0.5, 2.0)  # s
MOST_WINDOWS = 400
UNSTABLE = 10.0  # rad


def error_table(
    simulated: SimulatedRobot, values: np.ndarray, episodes: Sequence[Episode], joints: np.ndarray, until: float | None
) -> dict[str, Any]:
    """Open-loop replay errors of one parameter set.

    Args:
        joints: which joints count in what is summed over joints, (J,) bool.
        until: seconds of each motion that count.

    Returns:
        `joint_rmse_rad`, `translation_m`, `rotation_rad` (root mean square, over whole motions), `per_joint`, `per_episode`, and
        `by_horizon`: the same for windows of 0.1, 0.5 and 2 s that restart at measured states.
    """
    windows = whole(episodes, until)
    table = summary(simulated, replayed(simulated, values, windows), windows, joints)
    table["by_horizon"] = {}
    for seconds in HORIZONS:
        short = split(episodes, seconds, until)
        chosen = [
            short[i]
            for i in sorted(set(np.linspace(0, len(short) - 1, min(len(short), MOST_WINDOWS)).round().astype(int).tolist()))
        ]
        found = summary(simulated, replayed(simulated, values, chosen), chosen, joints)
        table["by_horizon"][f"{seconds:g} s"] = {name: found[name] for name in ("joint_rmse_rad", "translation_m", "rotation_rad")}
    table["by_horizon"]["whole"] = {name: table[name] for name in ("joint_rmse_rad", "translation_m", "rotation_rad")}
    return table


def replayed(simulated: SimulatedRobot, values: np.ndarray, windows: Sequence[Window]) -> list[np.ndarray]:
    """Simulated positions of one parameter set, one array a window."""
    return [one[0] for one in rollout(simulated, values, windows)]


def perfect_tracking(
    simulated: SimulatedRobot, episodes: Sequence[Episode], joints: np.ndarray, until: float | None
) -> dict[str, Any] | None:
    """The errors of a robot that is always where it is told to be; None where some joint is told a torque or a speed."""
    robot, windows = simulated.robot, whole(episodes, until)
    if not all(holds_position(robot.model, joint) for joint in robot.joints):
        return None
    return summary(simulated, [commanded(window) for window in windows], windows, joints)


def summary(
    simulated: SimulatedRobot, positions: Sequence[np.ndarray], windows: Sequence[Window], joints: np.ndarray
) -> dict[str, Any]:
    """Errors of given positions against the measured ones; the first row, where each replay starts, does not count."""
    chain, names = Chain(simulated.robot), simulated.robot.joints
    errors, shifts, turns = [], [], []
    for found, window in zip(positions, windows, strict=True):
        found, measured = found[1:], window.measured[1:]
        shift, turn = pose_error(chain, np.where(np.isfinite(found), found, 0.0), measured)
        errors.append(np.nan_to_num(found - measured, nan=UNSTABLE))
        shifts.append(shift)
        turns.append(turn)
    per_episode: dict[str, Any] = {}
    for window, error, shift, turn in zip(windows, errors, shifts, turns, strict=True):
        per_episode[window.episode.name] = _row([error[:, joints]], [shift], [turn])
    every = np.concatenate(errors)
    per_joint = {name: _rms(every[:, i]) for i, name in enumerate(names)}
    return {**_row([e[:, joints] for e in errors], shifts, turns), "per_joint": per_joint, "per_episode": per_episode}


def before_and_after(after: Mapping[str, Any], before: Mapping[str, Any], perfect: Mapping[str, Any] | None) -> dict[str, Any]:
    """One side of the split as the result prints it; `perfect_tracking` is None where no robot could do that."""
    short = ("joint_rmse_rad", "translation_m", "rotation_rad", "per_joint", "per_episode")
    shown = {name: perfect[name] for name in short} if perfect else None
    return {**after, "before": dict(before), "perfect_tracking": shown}


def _row(errors: Sequence[np.ndarray], shifts: Sequence[np.ndarray], turns: Sequence[np.ndarray]) -> dict[str, float]:
    return {
        "joint_rmse_rad": _rms(np.concatenate(errors)),
        "translation_m": _rms(np.concatenate(shifts)),
        "rotation_rad": _rms(np.concatenate(turns)),
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def commanded(window: Window) -> Float[np.ndarray, "T J"]:
    """The command in force at each measurement of a window [rad or m]."""
    episode = window.episode
    return episode.command[episode.in_force(episode.times[window.first : window.last + 1])]
