"""Dry friction that differs between the directions."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values
from edream.core.parameters import Parameter
from edream.sim.scales import largest
from edream.sim.servo import NO_INPUT, TURNED, device, passive_device


class AsymmetricCoulomb(Effect):
    """A gear that runs harder one way than the other.

        F = F0 + d for qd > 0,  F0 - d for qd < 0

    Dry friction between -(F0 + d) and F0 - d is friction F0 and a constant torque -d, in motion and at rest: no motion can tell
    this from `constant_torque`, only knowledge of what could pull at the joint. Native, as that. Parameter: difference d, half
    of that between the directions [N m]. Source: Armstrong-Helouvry, Dupont, Canudas de Wit, 1994.
    """

    name = "asymmetric_coulomb"
    summary = "dry friction that differs between the directions"
    place = "joint"
    confusable = ("constant_torque", "directional_efficiency", "gravity_tilt")
    of_type = False

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        high = 2.0 * largest(model, targets)
        return (Parameter("difference", "N m", -high, high, 0.0, absent=0.0),)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        device_ = passive_device(spec, target, self.name)
        device_.set_to_dcmotor(motorconst=[0.0, 0.0], resistance=1.0, cogging=[1e-9, 0.0, TURNED], ctrlspec=NO_INPUT)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        fields["actuator_biasprm"][:, device(fields.model, target, self.name), 0] = -values["difference"]


ENTRY = AsymmetricCoulomb()
