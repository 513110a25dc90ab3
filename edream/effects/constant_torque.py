"""A torque that is always there."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values
from edream.core.parameters import Parameter
from edream.sim.scales import most_torque
from edream.sim.servo import NO_INPUT, TURNED, device, passive_device


class ConstantTorque(Effect):
    """A constant torque on the joint: a spring far from its rest length, a hose, a current offset.

        tau = T

    Shifts the joint the same way in every pose and direction. Native: a `dcmotor` without input whose cogging has no poles,
    so that its sine is a constant. Parameter: torque T [N m]. Source: MuJoCo XML reference, actuator/dcmotor/cogging.
    """

    name = "constant_torque"
    summary = "a constant torque"
    place = "joint"
    confusable = ("gravity_tilt", "encoder_offset", "sensor_bias", "spring", "payload", "asymmetric_coulomb")
    of_type = False

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        high = 2.0 * most_torque(model, targets)
        return (Parameter("torque", "N m", -high, high, 0.0, absent=0.0),)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        device_ = passive_device(spec, target, "constant_torque")
        device_.set_to_dcmotor(motorconst=[0.0, 0.0], resistance=1.0, cogging=[1e-9, 0.0, TURNED], ctrlspec=NO_INPUT)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        fields["actuator_biasprm"][:, device(fields.model, target, "constant_torque"), 0] = values["torque"]


ENTRY = ConstantTorque()
