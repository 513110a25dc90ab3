"""Inertia of the motor's rotor, felt through its gear."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter
from edream.sim.rotor import LINK_SHARE
from edream.sim.scales import rotor_guess


class Armature(Effect):
    """Rotor inertia reflected through the gear, the same in every pose.

        tau = -I qdd

    Shows up on fast small steps and chirps. Writes `armature`.
    Parameter: inertia I [kg m^2], absolute. Source: MuJoCo XML reference, body/joint/armature.
    """

    name = "armature"
    summary = "another rotor inertia"
    place = "joint"
    confusable = ("actuator_delay", "payload")

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        dof = joint_index(model, targets[0])["dof"]
        nominal = float(model.dof_armature[dof])
        guess = rotor_guess(model, targets[0])
        around = max(nominal, guess, 0.05 * float(model.dof_M0[dof]), 1e-6)
        start = max(nominal, guess, around / 100.0)
        return (Parameter("inertia", "kg m^2", around / 100.0, around * 20.0, start, scale="log", guessed=nominal == 0.0),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        start = self.parameters(model, targets)[0].start
        return ({"inertia": 0.5 * start}, {"inertia": 2.0 * start})

    def write(self, fields: Fields, target: str, values: Values) -> None:
        index = joint_index(fields.model, target)
        fields["dof_armature"][:, index["dof"]] = values["inertia"]
        if index["drive"] != index["dof"]:
            fields["dof_armature"][:, index["dof"]] *= LINK_SHARE
            fields["dof_armature"][:, index["drive"]] = (1.0 - LINK_SHARE) * values["inertia"]


ENTRY = Armature()
