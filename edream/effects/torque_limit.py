"""A motor that cannot give more than so much torque."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.scales import largest, strongest
from edream.sim.servo import damping_inside, servo, share_damping


class TorqueLimit(Effect):
    """Saturation of the motor's torque.

        |tau| <= T

    Nothing on light moves; heavy or fast ones fall behind. The servo's share of the damping is within the limit.
    Writes the servo's `forcerange`. Parameters: torque T [N m], absolute; inside: that share [1], about as published.
    Source: MuJoCo XML reference, actuator/general/forcerange.
    """

    name = "torque_limit"
    summary = "a limit of the motor torque"
    place = "joint"
    confusable = ("torque_speed_limit", "servo_gain", "slew_limit")
    late = 2

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        scale, nominal = largest(model, targets), max(strongest(model, target) for target in targets)
        return (
            Parameter("torque", "N m", min(0.05 * scale, 0.5 * nominal), nominal, nominal, absent=nominal, scale="log"),
            damping_inside(model, targets),
        )

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        torque, inside = self.parameters(model, targets)
        # close to each other: a limit does nothing above the torques of a motion and stops it below them
        limits = np.geomspace(0.2, 3.2, 13) * largest(model, targets)
        return tuple({"torque": min(limit, torque.high), "inside": inside.start} for limit in limits)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        actuator = servo(spec, target)
        actuator.forcelimited = True
        if not np.any(actuator.forcerange):
            actuator.forcerange = [-1e6, 1e6]

    def write(self, fields: Fields, target: str, values: Values) -> None:
        share_damping(fields, target, values["inside"])
        actuator = joint_index(fields.model, target)["actuator"]
        fields["actuator_forcerange"][:, actuator, 0] = -values["torque"]
        fields["actuator_forcerange"][:, actuator, 1] = values["torque"]


ENTRY = TorqueLimit()
