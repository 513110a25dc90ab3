"""Position gain of the servo."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values, holds_position, joint_index
from edream.core.errors import EdreamError
from edream.core.parameters import Parameter
from edream.sim.servo import is_pid


class ServoGain(Effect):
    """How stiffly the servo holds its commanded position.

        tau = kp (u - q) - kv qd

    Too low a gain sags under gravity, equally in both directions and at all speeds. Writes `gainprm[0]` and `biasprm[1]` together,
    and `biasprm[0]` where the model has one, so that the servo still holds the same positions.
    Parameter: kp [N m/rad], absolute. A motor or a velocity servo has no kp: there it is what a command of 1 gives,

        tau = gain u - b qd,

    with b the sum of all damping, a velocity servo's own included (`viscous`). Parameter: gain [N m per unit of command], absolute.
    Source: MuJoCo XML reference, actuator/position, actuator/velocity, actuator/motor.
    """

    name = "servo_gain"
    summary = "another servo gain"
    place = "joint"
    confusable = ("payload", "compliance", "gear_ratio")

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        actuator = joint_index(model, targets[0])["actuator"]
        position = [holds_position(model, target) for target in targets]
        if len(set(position)) > 1:
            tied = ", ".join(targets)
            raise EdreamError(f"Joints {tied} are tied, but only some hold a position; tie joints with servos of one kind.")
        if position[0]:
            kp = -float(model.actuator_biasprm[actuator, 1])
            return (Parameter("kp", "N m/rad", kp / 200.0, kp * 10.0, kp, scale="log"),)
        gain = float(model.actuator_gainprm[actuator, 0])
        if gain <= 0.0:
            kinds = "a motor, position or velocity servo"
            raise EdreamError(f"The actuator of joint {targets[0]!r} has a gain of {gain:g}; expected {kinds}.")
        # nothing but weight tells a motor's gain from all that it works against, so that far is enough
        low, high = (gain / 2.0, gain * 2.0) if model.actuator_biasprm[actuator, 2] == 0.0 else (gain / 200.0, gain * 10.0)
        return (Parameter("gain", "N m per unit of command", low, high, gain, scale="log"),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        (gain,) = self.parameters(model, targets)
        return ({gain.name: 0.8 * gain.start}, {gain.name: 1.25 * gain.start})

    def write(self, fields: Fields, target: str, values: Values) -> None:
        actuator = joint_index(fields.model, target)["actuator"]
        if "gain" in values:
            fields["actuator_gainprm"][:, actuator, 0] = values["gain"]
            return
        gain, law = fields.model.actuator_gainprm[actuator], fields.model.actuator_biasprm[actuator]
        share = values["kp"] / -law[1]
        if not is_pid(fields.model, actuator):
            fields["actuator_gainprm"][:, actuator, 0] = gain[0] * share
        if law[0]:
            fields["actuator_biasprm"][:, actuator, 0] = law[0] * share
        fields["actuator_biasprm"][:, actuator, 1] = -values["kp"]


ENTRY = ServoGain()
