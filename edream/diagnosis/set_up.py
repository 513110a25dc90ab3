"""Other set-ups of a robot under which a motion may be recorded: what a command cannot tell, another gain or a known weight may."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.effect import joint_index
from edream.diagnosis.problem import Problem
from edream.sim.mass import HAND_WEIGHT, hand_of
from edream.sim.scales import strongest
from edream.sim.simulation import SERVO_GAIN

SOFT = 0.5  # of the usual gain of the servos: what pulls beside a servo, and what only reads another angle, differ then
HEAVY = 0.75  # of the robot's own pull on the joint that it pulls most
BEARABLE = 0.8  # of a servo's limit
NOTHING = 1e-6  # of what a weight pulls at the joint that it pulls most
POSES = 100  # of each recording


def other_set_ups(problem: Problem) -> list[dict[str, float]]:
    """Conditions to record under beside the usual ones: a lower gain, a weight in the hand, and both; those that the robot has."""
    softer, heavier = lower_gain(problem), weighted(problem)
    return [one for one in (softer, heavier, softer | heavier if softer and heavier else {}) if one]


def lower_gain(problem: Problem) -> dict[str, float]:
    """The condition under which the servos have `SOFT` times the gain that they mostly had; empty where no condition scales it."""
    scaling = problem.settings.scaled.get(SERVO_GAIN)
    if scaling is None:
        return {}
    had = [window.episode.conditions.get(scaling.condition, scaling.reference) for window in problem.fitted]
    return {scaling.condition: SOFT * float(np.median(had))}


def weighted(problem: Problem) -> dict[str, float]:
    """The condition under which the hand holds a weight, which pulls `HEAVY` times as much as the robot itself in its poses.

    Empty where gravity pulls at no joint, where recordings were made with a weight already, where the servos cannot bear one, or
    where the body at the end has no name.
    """
    if not problem.robot.model.body(hand_of(problem.robot)[0]).name:
        return {}
    if any(window.episode.conditions.get(HAND_WEIGHT) for window in problem.fitted):
        return {}
    own, each = pulls(problem)
    limits = np.array([strongest(problem.robot.model, joint) for joint in problem.fitted[0].episode.joints])
    if not own.max() > 0.0 or not each.max() > 0.0:
        return {}
    most = HEAVY * own.max() / each.max()
    pulled = each > NOTHING * each.max()
    bearable = ((BEARABLE * limits - own)[pulled] / each[pulled]).min()
    weight = two_digits(min(most, bearable))
    return {HAND_WEIGHT: weight} if weight > 0.0 else {}


def pulls(problem: Problem) -> tuple[Float[np.ndarray, "J"], Float[np.ndarray, "J"]]:
    """The most that the robot's weight pulls at each joint in the recorded poses [N m], and what 1 kg in its hand adds."""
    model, (hand, point) = problem.robot.model, hand_of(problem.robot)
    data, slope = mujoco.MjData(model), np.zeros((3, model.nv))
    index = [joint_index(model, joint) for joint in problem.fitted[0].episode.joints]
    dofs, places = [one["dof"] for one in index], [one["qpos"] for one in index]
    own, each = np.zeros(len(index)), np.zeros(len(index))
    for window in problem.fitted:
        positions = window.episode.position
        for pose in positions[:: max(1, len(positions) // POSES)]:
            data.qpos[places] = pose
            mujoco.mj_forward(model, data)
            mujoco.mj_jac(model, data, slope, None, data.xpos[hand] + data.xmat[hand].reshape(3, 3) @ point, hand)
            own = np.maximum(own, np.abs(data.qfrc_bias[dofs]))
            each = np.maximum(each, np.abs(slope.T @ model.opt.gravity)[dofs])
    return own, each


def two_digits(weight: float) -> float:
    """A weight that one can say, no heavier: with two digits; 0 where there is none."""
    if weight <= 0.0:
        return 0.0
    unit = 10.0 ** (np.floor(np.log10(weight)) - 1)
    return float(np.round(np.floor(weight / unit + 1e-9) * unit, 12))


def how_to_record(conditions: Sequence[Mapping[str, float]]) -> str:
    """What to do with a suggested motion, in words."""
    if not any(conditions):
        return "Record the suggested motion a few times."
    noted = {f"{name} = {value:g}" for one in conditions for name, value in one.items()}
    ways = [" and ".join(_in_words(*known) for known in one.items()) or "as the robot is" for one in conditions]
    said = ", and a few times ".join(ways)
    return f"Record the suggested motion a few times {said}; note {' and '.join(sorted(noted))} of these in conditions.csv."


def _in_words(condition: str, value: float) -> str:
    if condition == HAND_WEIGHT:
        return f"with a weight of {value:g} kg in the hand (or another that you note)"
    return f"with {SOFT:g} times the servos' usual position gain"
