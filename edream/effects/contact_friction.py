"""How slippery an object is."""

from collections.abc import Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values
from edream.core.parameters import Parameter


class ContactFriction(Effect):
    """Sliding friction of one geom's contacts.

        |f_t| <= mu f_n

    Objects slide further, or not at all. Writes `friction[0]` of the geom and raises its `priority`, so that its own value
    counts and not the larger of both. Parameter: friction mu [1], absolute.
    Source: MuJoCo XML reference, body/geom/friction and priority.
    """

    name = "contact_friction"
    summary = "another contact friction"
    place = "geom"
    confusable = ("coulomb",)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        # MuJoCo takes the larger of both geoms' friction, so what holds so far is the largest of all that can touch
        touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        nominal = max(float(model.geom(targets[0]).friction[0]), float(model.geom_friction[touching, 0].max(initial=0.0)))
        return (Parameter("friction", "1", 0.02, 5.0, float(np.clip(nominal, 0.02, 5.0)), scale="log"),)

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        return tuple({"friction": factor * float(self.parameters(model, targets)[0].start)} for factor in (0.8, 1.25))

    def edit(self, spec: mujoco.MjSpec, target: str) -> None:
        spec.geom(target).priority += 1

    def write(self, fields: Fields, target: str, values: Values) -> None:
        fields["geom_friction"][:, fields.model.geom(target).id, 0] = values["friction"]


ENTRY = ContactFriction()
