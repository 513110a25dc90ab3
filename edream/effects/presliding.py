"""Friction that gives like a spring before it slides."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.scales import most_torque
from edream.sim.servo import NO_INPUT, device, passive_device

RELAXATION = 0.005  # s, bristle damping over bristle stiffness

LONGEST = 0.15  # rad


class Presliding(Effect):
    """Bristles: friction first bends like a spring, and slides once it is bent far enough (LuGre).

        tau = -s0 z,  zd = qd - s0 |qd| z / F,  s0 = F / x

    Rounds the corners of the loop between measured and commanded position: friction depends on the way since the last reversal, not
    on speed. Native: `lugre` of a `dcmotor` without input, one activation. A bristle damping of s0 times 5 ms keeps it calm.
    Parameters: torque F [N m], displacement x [rad]. Source: Canudas de Wit et al., IEEE T. Automatic Control 40(3), 1995.
    """

    name = "presliding"
    summary = "friction that gives before it slides (presliding)"
    place = "joint"
    confusable = ("coulomb", "backlash", "stribeck")

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        high = 2.0 * most_torque(model, targets)
        # the stiffest bristle that a step of this length carries on the lightest of the joints
        inertia = min(float(model.dof_M0[joint_index(model, target)["dof"]]) for target in targets)
        short = max(5e-4, high * float(model.opt.timestep) ** 2 / (0.1 * inertia))
        return (
            Parameter("torque", "N m", 0.0, high, 0.0, absent=0.0),
            Parameter("displacement", "rad", short, max(20.0 * short, LONGEST), 3.0 * short, scale="log"),
        )

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        torque, shape = self.parameters(model, targets)
        return tuple({"torque": 0.05 * torque.high, "displacement": factor * shape.low} for factor in (2.0, 8.0, 30.0))

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        device_ = passive_device(spec, target, "presliding")
        device_.set_to_dcmotor(motorconst=[0.0, 0.0], resistance=1.0, lugre=[1.0, RELAXATION, 1.0, 1.0, 1.0], ctrlspec=NO_INPUT)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        row = device(fields.model, target, "presliding")
        torque = np.maximum(values["torque"], 1e-12)
        stiffness = torque / values["displacement"]
        fields["actuator_biasprm"][:, row, 3] = fields["actuator_biasprm"][:, row, 4] = torque
        fields["actuator_dynprm"][:, row, 5] = stiffness
        fields["actuator_dynprm"][:, row, 6] = RELAXATION * stiffness


ENTRY = Presliding()
