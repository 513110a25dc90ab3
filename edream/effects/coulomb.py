"""Dry friction."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still, let_creep
from edream.sim.rotor import drive_joint
from edream.sim.scales import most_friction


def friction(model: mujoco.MjModel, targets: Sequence[str]) -> Parameter:
    """Dry friction [N m], as published."""
    nominal = float(model.dof_frictionloss[joint_index(model, targets[0])["drive"]])
    high = most_friction(model, targets)
    return Parameter("torque", "N m", 0.0, high, float(np.clip(nominal, 0.0, high)), absent=0.0)


class CreepingCoulomb(Effect):
    """The same as `Coulomb`, but smooth at standstill: it grows with speed until it is whole, so that a stuck joint creeps.

        tau = -F clip(qd / vc, -1, 1)

    Grease does that, and so do simulators that make friction smooth; `impedance` is how they do (`edream.sim.friction`).
    Parameters: torque F [N m], creep vc [rad/s].
    """

    name = "coulomb"
    summary = "dry friction"
    place = "joint"

    def __init__(self, impedance: float) -> None:
        self.impedance = impedance

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        creep = Parameter("creep", "rad/s", 1e-5, 0.3, 1e-3, scale="log", spread=3.0, guessed=True)
        return (friction(model, targets), creep)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))

    def write(self, fields: Fields, target: str, values: Values) -> None:
        drive = joint_index(fields.model, target)["drive"]
        fields["dof_frictionloss"][:, drive] = values["torque"]
        let_creep(fields, drive, values["torque"], values["creep"], self.impedance)


class Coulomb(Effect):
    """Dry friction: the same at every speed, and able to hold the joint still.

        tau = -F sign(qd), |tau| <= F at rest

    Shows up as a loop of half width F/kp between measured and commanded position. Writes `frictionloss`, hardened so that
    a stuck joint does not creep (`edream.sim.friction`).
    Parameter: torque F [N m], absolute. Source: Olsson et al., European Journal of Control 4(3), 1998.
    """

    name = "coulomb"
    summary = "dry friction"
    place = "joint"
    confusable = ("dead_zone", "backlash", "load_friction")
    softer = (CreepingCoulomb(0.1), CreepingCoulomb(0.9))

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (friction(model, targets),)

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))

    def write(self, fields: Fields, target: str, values: Values) -> None:
        fields["dof_frictionloss"][:, joint_index(fields.model, target)["drive"]] = values["torque"]


ENTRY = Coulomb()
