"""A joint that feels another joint."""

from collections.abc import Sequence
from typing import Any

import mujoco

from edream.core.effect import Effect, State
from edream.core.parameters import Parameter
from edream.sim.scales import largest, most_torque


def joint_coupling(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """The first joint feels the position and speed of the second."""
    position, speed = state.qpos[:, index["other_qpos"]], state.qvel[:, index["other_dof"]]
    state.torque[:, index["dof"]] -= values["stiffness"] * position + values["damping"] * speed


class JointCoupling(Effect):
    """A cable, hose or shared gear that lets one joint's position and speed act on another.

        tau_first = -k q_second - d qd_second

    What is left over on the first joint follows the motion of the second. A hook adds the torque; a tendon would act on both.
    Parameters: stiffness k [N m/rad], damping d [N m s/rad]. Source: Gautier, Khalil, Modeling of Robots, coupled joints, 2002.
    """

    name = "joint_coupling"
    summary = "a coupling from another joint"
    place = "pair"
    confusable = ("payload", "gravity_tilt")
    hook = staticmethod(joint_coupling)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        high = 1.5 * most_torque(model, [targets[0].split("<-")[0]])
        return (
            Parameter("stiffness", "N m/rad", -high, high, 0.0, absent=0.0),
            Parameter("damping", "N m s/rad", -0.5 * high, 0.5 * high, 0.0, absent=0.0),
        )

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        torque = 0.05 * largest(model, [targets[0].split("<-")[0]])
        return ({"stiffness": torque, "damping": 0.0}, {"stiffness": 0.0, "damping": 0.5 * torque})


ENTRY = JointCoupling()
