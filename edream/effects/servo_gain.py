"""Position gain of the servo."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.servo import is_pid


class ServoGain(Effect):
    """How stiffly the servo holds its commanded position.

        tau = kp (u - q) - kv qd

    Too low a gain sags under gravity, equally in both directions and at all speeds. Writes `gainprm[0]` and `biasprm[1]` together.
    Parameter: kp [N m/rad], absolute. Source: MuJoCo XML reference, actuator/position.
    """

    name = "servo_gain"
    summary = "another servo gain"
    place = "joint"
    confusable = ("payload", "compliance", "gear_ratio")

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        kp = -float(model.actuator_biasprm[joint_index(model, targets[0])["actuator"], 1])
        return (Parameter("kp", "N m/rad", kp / 200.0, kp * 10.0, kp, scale="log"),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        start = self.parameters(model, targets)[0].start
        return ({"kp": 0.8 * start}, {"kp": 1.25 * start})

    def write(self, fields: Fields, target: str, values: Values) -> None:
        actuator = joint_index(fields.model, target)["actuator"]
        if not is_pid(fields.model, actuator):
            fields["actuator_gainprm"][:, actuator, 0] = values["kp"]
        fields["actuator_biasprm"][:, actuator, 1] = -values["kp"]


ENTRY = ServoGain()
