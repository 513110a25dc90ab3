"""A gear with play."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values
from edream.core.parameters import Parameter
from edream.sim.rotor import GEAR_SUFFIX, add_rotor, behind, gear_feedback, open_gear, write_bearing

SMALLEST = 1e-6  # rad; less is no play


class Backlash(Effect):
    """Play between motor and link: at each reversal the link waits while the motor crosses the gap.

        |motor - link| <= b

    The wait is a fixed angle, whatever the torque, the gain and the speed, and gravity hides it. Native: a rotor `<joint>_motor`
    and a fixed tendon with a `range`. Where `compliance` acts on the same joint, the gap is in its spring. A servo whose encoder
    sits behind the gear follows the link, which MJCF has no word for: a hook puts kp times the twist on the rotor. Parameters:
    play b, half of the gap [rad], feedback [1]: 0 where the servo follows its motor, 1 where it follows the link, bearing: dry
    friction of the link itself [N m], which keeps it from swinging in the gap. Source: Nordin, Gutman, Automatica 38(10), 2002.
    """

    name = "backlash"
    summary = "play in the gear (backlash)"
    place = "joint"
    confusable = ("coulomb", "dead_zone", "presliding", "compliance")
    of_position_servo = True
    rough = True
    hook = staticmethod(gear_feedback)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("play", "rad", 0.0, 0.1, 0.0, absent=0.0), *behind(model, targets))

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        bearing = self.parameters(model, targets)[2].start
        return tuple({"play": play, "feedback": side, "bearing": bearing} for side in (0.0, 1.0) for play in (0.003, 0.008, 0.018))

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        tendon = add_rotor(spec, target)
        if not tendon.stiffness[0]:
            tendon.limited = True
            tendon.range = [-1.0, 1.0]
            tendon.solref_limit = [2.0 * spec.option.timestep, 1.0]
            tendon.solimp_limit = [0.99, 0.999, 0.001, 0.5, 2.0]

    def write(self, fields: Fields, target: str, values: Values) -> None:
        tendon = fields.model.tendon(target + GEAR_SUFFIX).id
        edges = np.stack([-values["play"], values["play"]], axis=1)
        if fields.model.tendon_stiffness[tendon]:
            fields["tendon_lengthspring"][:, tendon] = edges
        else:
            fields["tendon_range"][:, tendon] = edges + [-SMALLEST, SMALLEST]
        open_gear(fields, target, values["play"] > SMALLEST)
        write_bearing(fields, target, values["bearing"], values["play"] > SMALLEST)


ENTRY = Backlash()
