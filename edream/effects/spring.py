"""A spring beside the joint."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.scales import largest, position_gain, travel


class Spring(Effect):
    """A spring or cable that pulls the joint to a rest angle.

        tau = -k (q - q0)

    Smooth over the pose, the same in both directions, and untouched by a payload. Writes `stiffness` and `springref`.
    Parameters: stiffness k [N m/rad], reference q0 [rad]. Source: MuJoCo XML reference, body/joint/stiffness.
    """

    name = "spring"
    summary = "a spring beside the joint"
    place = "joint"
    confusable = ("hardening_spring", "constant_torque", "payload", "encoder_offset", "gravity_tilt")
    of_type = False

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        # up to half as stiff as the servo: at a light wrist that is many times what gravity asks for
        high = max(2.0 * largest(model, targets), *(0.5 * position_gain(model, joint) for joint in targets))
        low, top = travel(model, targets[0])
        return (
            Parameter("stiffness", "N m/rad", 0.0, high, 0.0, absent=0.0),
            Parameter("reference", "rad", low, top, 0.5 * (low + top)),
        )

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        reference = self.parameters(model, targets)[1]
        rests = (reference.low, reference.start, reference.high)
        return tuple({"stiffness": 0.1 * largest(model, targets), "reference": rest} for rest in rests)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        index = joint_index(fields.model, target)
        fields["jnt_stiffness"][:, index["joint"]] = fields.model.jnt_stiffness[index["joint"]] + values["stiffness"]
        fields["qpos_spring"][:, index["qpos"]] = values["reference"]


ENTRY = Spring()
