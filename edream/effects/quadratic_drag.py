"""Resistance that grows with the square of speed."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.scales import most_torque


class QuadraticDrag(Effect):
    """Drag of grease, air or a pump: small on slow moves, large on fast ones.

        tau = -c qd |qd|

    Curves the torque over speed upward. Writes the second `damping` coefficient, which MuJoCo integrates implicitly.
    Parameter: drag c [N m s^2/rad^2]. Source: MuJoCo XML reference, body/joint/damping.
    """

    name = "quadratic_drag"
    summary = "drag that grows with the square of speed"
    place = "joint"
    confusable = ("viscous", "torque_speed_limit")

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("drag", "N m s^2/rad^2", 0.0, 5.0 * most_torque(model, targets), 0.0, absent=0.0),)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        fields["dof_dampingpoly"][:, joint_index(fields.model, target)["drive"], 0] = values["drag"]


ENTRY = QuadraticDrag()
