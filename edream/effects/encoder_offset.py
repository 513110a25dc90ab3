"""A joint's zero that is not where the model has it."""

from collections.abc import Sequence

import mujoco

from edream.core.effect import Effect, Fields, Values, joint_index
from edream.core.parameters import Parameter


class EncoderOffset(Effect):
    """Zero of the encoder: commands and measurements count from a point that the model has elsewhere.

        q_model = q_encoder - b

    Seen only through gravity and inertia, which depend on the true pose. Writes `qpos0` (MJCF: joint `ref`).
    Parameter: angle b [rad]. Source: MuJoCo XML reference, body/joint/ref.
    """

    name = "encoder_offset"
    summary = "a zero offset of the encoder"
    place = "joint"
    confusable = ("payload", "constant_torque", "spring", "gravity_tilt")
    of_type = False
    shifts_links = True

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        return (Parameter("angle", "rad", -0.35, 0.35, 0.0, absent=0.0, spread=0.1),)

    def write(self, fields: Fields, target: str, values: Values) -> None:
        index = joint_index(fields.model, target)
        for qpos in {index["qpos"], index["drive_qpos"]}:
            fields["qpos0"][:, qpos] = fields.model.qpos0[qpos] + values["angle"]


ENTRY = EncoderOffset()
