"""A base that does not stand level."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values
from edream.core.parameters import Parameter

STEEPEST = 0.3  # rad: a robot that leans more is seen to; one that seems to has its weight or its servos otherwise than the model


class GravityTilt(Effect):
    """Gravity that points elsewhere than the model says: the robot stands or hangs at an angle.

        g = Ry(b) Rx(a) g0

    Changes the load of every joint at once, also of those whose axis the model has vertical. Writes `opt.gravity`.
    Parameters: about_x a, about_y b [rad]. Source: MuJoCo XML reference, option/gravity.
    """

    name = "gravity_tilt"
    summary = "a base that does not stand level"
    place = "world"
    confusable = ("encoder_offset", "constant_torque", "payload", "spring")

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"about_{axis}", "rad", -0.5, 0.5, 0.0, absent=0.0) for axis in "xy")

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return tuple({"about_x": 0.03 * a, "about_y": 0.03 * b} for a, b in ((1.0, 0.0), (0.0, 1.0)))

    def is_usual(self, values: Mapping[str, float]) -> bool:
        return max(map(abs, values.values())) <= STEEPEST

    def write(self, fields: Fields, target: str, values: Values) -> None:
        a, b = values["about_x"], values["about_y"]
        x, y, z = fields.model.opt.gravity
        y, z = y * np.cos(a) - z * np.sin(a), y * np.sin(a) + z * np.cos(a)
        fields["opt.gravity"][:] = np.stack([x * np.cos(b) + z * np.sin(b), y, z * np.cos(b) - x * np.sin(b)], axis=1)


ENTRY = GravityTilt()
