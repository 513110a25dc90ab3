"""A gear that gives."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.rotor import GEAR_SUFFIX, add_rotor, behind, gear_feedback, gear_limit, open_gear, write_bearing

RELAXATION = 0.002  # s, damping over stiffness


class Compliance(Effect):
    """A spring between motor and link (harmonic drive, belt, long shaft).

        tau = K (motor - link) + D (d motor - d link),  K = 1 / c

    The link rings after stops and sags under load; what is measured is the link. Native: a rotor `<joint>_motor` and a fixed tendon
    with `stiffness`. Below the give that this time step can carry, the gear is locked. Damping D = K times 2 ms. A servo whose
    encoder sits behind the gear follows the link, which MJCF has no word for: a hook puts kp times the twist on the rotor. It
    shakes without end where kp > K (Routh), so the hook stays below that. Parameters: give c [rad/(N m)], feedback [1]: 0 where
    the servo follows its motor, 1 where it follows the link, bearing: dry friction of the link itself [N m]. Source: Spong, J.
    of Dynamic Systems, Measurement and Control 109, 1987.
    """

    name = "compliance"
    summary = "a compliant gear"
    place = "joint"
    confusable = ("servo_gain", "backlash", "payload", "actuator_lag", "dead_zone")
    of_position_servo = True
    hook = staticmethod(gear_feedback)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        actuator = joint_index(model, targets[0])["actuator"]
        kp = -float(model.actuator_biasprm[actuator, 1])
        give = Parameter("give", "rad/(N m)", 0.0, max(2.0 / kp, 20.0 / gear_limit(model, targets[0])), 0.0, absent=0.0)
        return (give, *behind(model, targets))

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        give, _, bearing = self.parameters(model, targets)
        soft = 2.0 / min(gear_limit(model, target) for target in targets)
        return tuple(
            {"give": min(give.high, factor * soft), "feedback": side, "bearing": bearing.start}
            for side in (0.0, 1.0)
            for factor in (1.0, 3.0)
        )

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        tendon = add_rotor(spec, target)
        tendon.stiffness = [1.0, 0.0, 0.0]
        tendon.limited = False

    def write(self, fields: Fields, target: str, values: Values) -> None:
        stiffness = np.minimum(1.0 / np.maximum(values["give"], 1e-12), gear_limit(fields.model, target))
        is_open = values["give"] * gear_limit(fields.model, target) > 1.0
        tendon = fields.model.tendon(target + GEAR_SUFFIX).id
        fields["tendon_stiffness"][:, tendon] = np.where(is_open, stiffness, 0.0)
        fields["tendon_damping"][:, tendon] = np.where(is_open, RELAXATION * stiffness, 0.0)
        open_gear(fields, target, is_open)
        write_bearing(fields, target, values["bearing"], is_open)


ENTRY = Compliance()
