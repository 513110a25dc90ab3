"""A motor whose torque falls with its speed."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, State, Values
from edream.core.parameters import Parameter
from edream.sim.scales import largest, strongest
from edream.sim.servo import damping_inside, share_damping

FREE = 200.0  # rad/s: of a motor whose torque does not fall at any speed of an arm


def torque_speed_limit(state: State, index: dict[str, int], values: dict[str, Any]) -> None:
    """The motor's torque is limited by a line from stall torque to no-load speed."""
    dof, force = index["drive"], state.actuator_force[:, index["force"]]
    speed = state.qvel[:, dof]
    slowed = np.where(force * speed > 0.0, np.maximum(1.0 - np.abs(speed) / values["speed"], 0.0), 1.0)
    limit = values["stall"] * slowed
    state.torque[:, dof] += np.clip(force, -limit, limit) - force


class TorqueSpeedLimit(Effect):
    """Back-EMF: the faster the motor turns, the less torque its voltage can drive.

        |tau| <= Ts max(1 - |qd| / w0, 0)  while the motor drives,  |tau| <= Ts  while it brakes

    Fast moves flatten out at a top speed, slow ones are untouched. A hook takes back what exceeds the limit, from the force of
    the step before. Parameters: stall torque Ts [N m], no-load speed w0 [rad/s], inside: the servo's
    share of the damping [1], which is within the limit. Source: MuJoCo technical note on DC motors, 1.1.
    """

    name = "torque_speed_limit"
    summary = "a motor torque that falls with speed"
    place = "joint"
    confusable = ("torque_limit", "quadratic_drag", "slew_limit")
    hook = staticmethod(torque_speed_limit)
    late = 2
    special = ("torque_limit", "speed", FREE)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        # twice the servo's own limit, so that at the top of the box the line stays above it at any speed of an arm
        stall = 2.0 * max(strongest(model, target) for target in targets)
        return (
            Parameter("stall", "N m", min(0.05 * largest(model, targets), 0.5 * stall), stall, stall, absent=stall, scale="log"),
            Parameter("speed", "rad/s", 0.2, FREE, FREE, absent=FREE, scale="log"),
            damping_inside(model, targets),
        )

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        torque, (most, _, inside) = largest(model, targets), self.parameters(model, targets)
        # close to each other, as those of a torque limit
        pairs = product((torque, 2.0 * torque, most.high), np.geomspace(0.8, 10.0, 7))
        return tuple({"stall": min(limit, most.high), "speed": float(speed), "inside": inside.start} for limit, speed in pairs)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        share_damping(fields, target, values["inside"])


ENTRY = TorqueSpeedLimit()
