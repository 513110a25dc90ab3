"""A spring beside the joint that stiffens as it is stretched."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.scales import most_torque, travel

WIDE = 3.0  # rad of travel: over less a spring has to harden more to be seen


class HardeningSpring(Effect):
    """A cable or bumper whose pull grows faster than its stretch.

        tau = -k (q - q0) - k3 (q - q0)^3

    Little near its rest angle, much near the ends of travel. Writes the first and third `stiffness` coefficients and `springref`.
    Parameters: stiffness k [N m/rad], hardening k3 [N m/rad^3], reference q0 [rad]. Source: MuJoCo XML reference,
    body/joint/stiffness.
    """

    name = "hardening_spring"
    summary = "a spring that stiffens as it is stretched"
    place = "joint"
    confusable = ("spring", "constant_torque", "payload")
    of_type = False
    special = ("spring", "hardening", 0.0)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        high = most_torque(model, targets)
        low, top = travel(model, targets[0])
        short = min(1.0, (top - low) / WIDE)
        return (
            Parameter("stiffness", "N m/rad", 0.0, 2.0 * high, 0.0),
            Parameter("hardening", "N m/rad^3", 0.0, 2.0 * high / short**3, 0.0, absent=0.0),
            Parameter("reference", "rad", low, top, 0.5 * (low + top)),
        )

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        _, hardening, reference = self.parameters(model, targets)
        rests = (reference.low, reference.start, reference.high)
        return tuple({"stiffness": 0.0, "hardening": 0.05 * hardening.high, "reference": rest} for rest in rests)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        index = joint_index(fields.model, target)
        fields["jnt_stiffness"][:, index["joint"]] = fields.model.jnt_stiffness[index["joint"]] + values["stiffness"]
        fields["jnt_stiffnesspoly"][:, index["joint"], 1] = fields.model.jnt_stiffnesspoly[index["joint"], 1] + values["hardening"]
        fields["qpos_spring"][:, index["qpos"]] = values["reference"]


ENTRY = HardeningSpring()
