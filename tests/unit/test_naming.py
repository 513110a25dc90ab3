"""Which usual numbers are so strange that they are named."""

from types import SimpleNamespace

import mujoco
import pytest

from edream.catalog import load
from edream.core.effect import Effect
from edream.diagnosis.naming import strange_numbers
from edream.diagnosis.problem import Settings
from edream.sim.simulation import Placement

JOINTS = ("a", "b", "c", "d")


def arm(published: float) -> mujoco.MjModel:
    """Four joints in a row whose model has rotors; the last servo is a quarter as strong, and alone may have dry friction [N m]."""
    spec = mujoco.MjSpec()
    body = spec.worldbody
    for joint, gain in zip(JOINTS, (400.0, 400.0, 400.0, 100.0), strict=True):
        body = body.add_body(name=joint, pos=[0.2, 0.0, 0.0])
        body.add_geom(size=[0.03, 0.0, 0.0], mass=0.5)
        body.add_joint(name=joint, axis=[0, 1, 0], armature=0.1, frictionloss=published if joint == "d" else 0.0)
        motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT, forcerange=[-200, 200])
        motor.set_to_position(kp=gain, kv=10.0)
    return spec.compile()


@pytest.mark.parametrize(
    ("friction", "published", "named"),
    [
        ((6.0, 5.0, 4.0, 1.2), 0.0, []),  # what the model lacks on all of them is no news on one
        ((6.0, 0.3, 0.2, 0.1), 0.0, ["a"]),
        ((6.0, 5.0, 0.2, 0.1), 0.0, ["a", "b"]),  # two of four
        ((6.0, 5.0, 4.0, 1.2), 1.2, ["a", "b", "c"]),  # a model that has some says that the others have none
    ],
)
def test_dry_friction_that_is_published_nowhere_is_strange_only_where_others_have_little(
    friction: tuple[float, ...], published: float, named: list[str]
) -> None:
    model, coulomb = arm(published), load("effects", "coulomb", Effect)
    places = [Placement(coulomb, (joint,)) for joint in JOINTS]
    values = {place.full_name("torque"): value for place, value in zip(places, friction, strict=True)}
    robot = SimpleNamespace(model=model, joints=JOINTS, published=SimpleNamespace(model=model))
    problem = SimpleNamespace(robot=robot, settings=Settings(nuisance=("coulomb",)))
    fit = SimpleNamespace(
        values=values,
        space=SimpleNamespace(mapping=lambda values: values),
        intervals=lambda: {name: (0.95 * value, 1.05 * value) for name, value in values.items()},
        objective=SimpleNamespace(simulated=SimpleNamespace(placements=places)),
    )
    assert [one.targets[0] for one in strange_numbers(problem, fit)] == named  # type: ignore[arg-type]
