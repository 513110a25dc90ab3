"""Dry friction that differs between the directions."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.rotor import drive_joint
from edream.sim.scales import most_torque
from edream.sim.servo import NO_INPUT, TURNED, device, passive_device


class AsymmetricCoulomb(Effect):
    """A gear that runs harder one way than the other.

        F = max(F0 + d, 0) for qd > 0,  max(F0 - d, 0) for qd < 0

    Dry friction between two unequal bounds is friction of their mean and a torque of half their difference, in motion and at rest:
    no motion can tell this from `constant_torque` beside another dry friction. But friction only brakes, so neither bound falls
    below zero: a torque larger than the friction beside it is none of friction's. Native, as a torque and `frictionloss`.
    Parameter: difference d, half of that between the directions [N m]. Source: Armstrong-Helouvry, Dupont, Canudas de Wit, 1994.
    """

    name = "asymmetric_coulomb"
    summary = "dry friction that differs between the directions"
    place = "joint"
    confusable = ("constant_torque", "directional_efficiency", "gravity_tilt")
    late = 1
    of_type = False

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        high = 2.0 * most_torque(model, targets)
        return (Parameter("difference", "N m", -high, high, 0.0, absent=0.0),)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))
        device_ = passive_device(spec, target, self.name)
        device_.set_to_dcmotor(motorconst=[0.0, 0.0], resistance=1.0, cogging=[1e-9, 0.0, TURNED], ctrlspec=NO_INPUT)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        drive, friction = joint_index(fields.model, target)["drive"], fields["dof_frictionloss"]
        forth = np.maximum(friction[:, drive] + values["difference"], 0.0)
        back = np.maximum(friction[:, drive] - values["difference"], 0.0)
        friction[:, drive] = 0.5 * (forth + back)
        fields["actuator_biasprm"][:, device(fields.model, target, self.name), 0] = -0.5 * (forth - back)


ENTRY = AsymmetricCoulomb()
