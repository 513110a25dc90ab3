"""A mass that the model does not have."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from edream.core.effect import Effect, Fields, Values
from edream.core.parameters import Parameter
from edream.sim.mass import add_mass
from edream.sim.scales import last_driven, most_torque

PROBE = 0.02  # of the robot's mass
ASIDE = 0.07  # m
REACH = 0.15  # m, from the body's own centre of mass or its first site


class Payload(Effect):
    """A point mass on a body: a tool, a camera, a cable bundle, something held; negative where the model is too heavy.

        m' = m + dm,  m' c' = m c + dm p

    Its load follows the pose like gravity's and grows with acceleration; it is the same in both directions. Writes the body's mass,
    centre and inertia (diagonalised; where more is taken away than was there, that of what some body could be). Parameters: mass dm
    [kg]; place p in the body's frame: x, y, z [m], around the body's first site or, without one, its own centre of mass.
    Source: Khalil, Dombre, Modeling, Identification and Control of Robots, 2002.
    """

    name = "payload"
    summary = "a payload"
    place = "body"
    confusable = ("servo_gain", "spring", "encoder_offset", "gravity_tilt", "constant_torque")

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        body = model.body(targets[0]).id
        sites = [s for s in range(model.nsite) if model.site_bodyid[s] == body]
        centre = model.site_pos[sites[0]] if sites else model.body_ipos[body]
        places = (
            Parameter(axis, "m", c - REACH, c + REACH, c, spread=0.04) for axis, c in zip("xyz", map(float, centre), strict=True)
        )
        return (Parameter("mass", "kg", -0.4 * float(model.body_mass[body]), self._most(model, body), 0.0, absent=0.0), *places)

    def _most(self, model: mujoco.MjModel, body: int) -> float:
        """Half of the robot's mass, or what pulls at the servo before it as much as an effect may."""
        half = 0.5 * float(model.body_subtreemass[0])
        joint = last_driven(model, body)
        return half if joint is None else max(half, most_torque(model, [joint]) / (9.81 * REACH))

    def probes(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[dict[str, float], ...]:
        _, *places = self.parameters(model, targets)
        centre = {"mass": PROBE * float(model.body_subtreemass[0])} | {place.name: place.start for place in places}
        # where it hangs decides at which poses it pulls
        beside = [centre | {place.name: place.start + side * ASIDE} for place in places for side in (-1.0, 1.0)]
        return (centre, *beside)

    def is_usual(self, values: Mapping[str, float]) -> bool:
        return values["mass"] > 0.0

    def on_link(self, model: mujoco.MjModel, values: Mapping[str, float], link: str, other: str) -> dict[str, float]:
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        before, after = data.body(link), data.body(other)
        point = before.xpos + before.xmat.reshape(3, 3) @ [values[axis] for axis in "xyz"]
        there = after.xmat.reshape(3, 3).T @ (point - after.xpos)
        return {"mass": values["mass"], **dict(zip("xyz", map(float, there), strict=True))}

    def write(self, fields: Fields, target: str, values: Values) -> None:
        add_mass(fields, fields.model.body(target).id, values["mass"], np.stack([values[axis] for axis in "xyz"], axis=1))


ENTRY = Payload()
