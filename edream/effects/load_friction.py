"""Friction that grows with the load on the gear."""

from collections.abc import Sequence
from typing import Any

import mujoco

from edream.core.effect import Effect, Fields, State, Values
from edream.core.parameters import Parameter
from edream.sim.friction import hold_still
from edream.sim.rotor import drive_joint
from edream.sim.scales import largest
from edream.sim.servo import damping_inside, share_damping


def load_friction(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """Dry friction grows with the torque on the gear: from the load's side, from the motor's, or between the two."""
    load, motor = abs(state.gear_torque[:, index["dof"]]), abs(state.actuator_force[:, index["force"]])
    share = values["motor_share"]
    state.friction[:, index["drive"]] += values["slope"] * ((1.0 - share) * load + share * motor)


def load_friction_curved(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """The same, of which a part grows with the square of the torque."""
    load, motor = abs(state.gear_torque[:, index["dof"]]), abs(state.actuator_force[:, index["force"]])
    share = values["motor_share"]
    torque = (1.0 - share) * load + share * motor
    state.friction[:, index["drive"]] += (values["slope"] * torque + values["quadratic"] * torque**2).clip(0.0)


class CurvedLoadFriction(Effect):
    """Friction with the load that grows faster or slower than in proportion.

        F = F0 + max(k T + c T^2, 0),  T = (1 - m) |tau_load| + m |tau_motor|

    Parameters: those of `LoadFriction`, and quadratic c [1/(N m)].
    Source: Duclusaud et al. (BAM), 2024, whose last model has both terms.
    """

    name = "load_friction"
    summary = "load-dependent friction"
    place = "joint"
    confusable = ("coulomb", "directional_efficiency")
    hook = staticmethod(load_friction_curved)
    late = 2

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        most = 1.0 / largest(model, targets)
        return (
            Parameter("slope", "1", 0.0, 0.95, 0.0, absent=0.0),
            Parameter("motor_share", "1", 0.0, 1.0, 0.5),
            damping_inside(model, targets),
            Parameter("quadratic", "1/(N m)", -most, 3.0 * most, 0.0, absent=0.0),
        )

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        hold_still(spec, drive_joint(spec, target))

    def write(self, fields: Fields, target: str, values: Values) -> None:
        share_damping(fields, target, values["inside"])


class LoadFriction(CurvedLoadFriction):
    """Dry friction proportional to the load that the gear carries.

        F = F0 + k ((1 - m) |tau_load| + m |tau_motor|)

    The load is all that the gear passes on to its link: weight, motion and inertia. The loop between measured and commanded
    position is wide where gravity pulls and narrow where it does not. A gear that is loaded from its output (self-locking) has m
    near 0, one whose losses follow the motor's torque m near 1. Of the damping, what the servo does itself is part of the motor's
    torque. MJCF has no such term: a hook sets `dof_frictionloss` before each step.
    Parameters: slope k [1], motor_share m [1], inside: the servo's share of the damping [1], about as published.
    Source: Bittencourt, Gunnarsson, IEEE/ASME Transactions on Mechatronics 17(4), 2012; Duclusaud et al. (BAM), 2024.
    """

    hook = staticmethod(load_friction)
    finer = CurvedLoadFriction()

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return super().parameters(model, targets)[:3]

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        inside = damping_inside(model, targets).start
        return tuple({"slope": 0.05, "motor_share": share, "inside": inside} for share in (0.1, 0.9))


ENTRY = LoadFriction()
