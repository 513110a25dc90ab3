"""A gear with play."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values
from edream.core.parameters import Parameter
from edream.sim.rotor import GEAR_SUFFIX, add_rotor, open_gear

SMALLEST = 1e-6  # rad; less is no play


class Backlash(Effect):
    """Play between motor and link: at each reversal the link waits while the motor crosses the gap.

        |motor - link| <= b

    The wait is a fixed angle, whatever the torque, the gain and the speed, and gravity hides it. Native: a rotor `<joint>_motor`
    and a fixed tendon with a `range`. Where `compliance` acts on the same joint, the gap is in its spring. Parameter: play b,
    half of the gap [rad]. Source: Nordin, Gutman, Automatica 38(10), 2002.
    """

    name = "backlash"
    summary = "play in the gear (backlash)"
    place = "joint"
    confusable = ("coulomb", "dead_zone", "presliding", "compliance")

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("play", "rad", 0.0, 0.1, 0.0, absent=0.0),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return ({"play": 0.003}, {"play": 0.01})

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


ENTRY = Backlash()
