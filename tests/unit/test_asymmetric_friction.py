"""Dry friction with two bounds is a torque beside friction, but one that brakes only, and none at all on a joint that creeps."""

from dataclasses import replace

import numpy as np
import pytest

from edream import catalog
from edream.core.effect import Effect
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.descent import descend
from edream.diagnosis.problem import Settings, prepare
from edream.sim.rollout import rollout
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.window import whole
from tests.still_problem import NOISE, commanded, fit_of, having, pan_tilt

ROBOT = pan_tilt()
FRICTION = float(ROBOT.model.dof_frictionloss[0])


def moved(effect: str, value: float, episodes: list, friction: float = FRICTION) -> list[np.ndarray]:
    """Where a robot is with an effect on `pan` beside dry friction [N m]."""
    places = [Placement(catalog.load("effects", one, Effect), ("pan",)) for one in ("coulomb", effect)]
    return [one[0] for one in rollout(SimulatedRobot(ROBOT, places), np.array([[friction, value]]), whole(episodes))]


@pytest.mark.parametrize("share", [-0.9, 0.5])
def test_a_difference_below_the_friction_is_a_torque(share: float) -> None:
    episodes = [commanded(3, ROBOT.joints)]
    pulled = moved("constant_torque", -share * FRICTION, episodes)[0]
    braked = moved("asymmetric_coulomb", share, episodes)[0]
    assert np.abs(pulled - braked).max() < 2e-4 < 1e-3 < np.abs(braked - moved("asymmetric_coulomb", 0.0, episodes)[0]).max()


def test_friction_larger_one_way_than_all_of_it_does_not_push() -> None:
    one = commanded(0, ROBOT.joints)
    still = replace(one, command=np.zeros_like(one.command), position=np.zeros_like(one.position))
    pulled = moved("constant_torque", 5.0 * FRICTION, [still])[0][-1, 0]
    braked = moved("asymmetric_coulomb", 1.0, [still], 5.0 * FRICTION)[0][-1, 0]
    assert pulled > 2.0 * FRICTION / 20.0  # of what the servo's 20 N m/rad give
    assert abs(braked) < 1e-4


def test_a_torque_beyond_the_friction_is_not_explained_by_friction() -> None:
    episodes = [commanded(number, ROBOT.joints, 2.0) for number in range(4)]
    rng = np.random.default_rng(2)
    told = moved("constant_torque", 5.0 * FRICTION, episodes)
    made = [replace(e, position=m + rng.normal(0.0, NOISE, m.shape)) for e, m in zip(episodes, told, strict=True)]
    problem = prepare(ROBOT, made, Settings())
    fit = fit_of(problem)
    true = having(problem, fit, Candidate("constant_torque", ("pan",)), {"torque": 5.0 * FRICTION})
    begun = having(problem, fit, Candidate("asymmetric_coulomb", ("pan",)), {"asymmetry": -0.9})
    ended = descend(begun, None, 6)
    assert 2.0 * true.rms < ended.rms < begun.rms


@pytest.mark.parametrize(
    ("effect", "values"),
    [("asymmetric_coulomb", [0.9]), ("directional_efficiency", [0.3, 0.9])],
    ids=["asymmetric", "efficiency"],
)
def test_a_joint_that_creeps_comes_to_rest_where_nothing_pulls_at_it(effect: str, values: list[float]) -> None:
    """No torque acts at rest: beside friction that creeps the same joint ends where it does without the effect."""
    one = commanded(0, ROBOT.joints, 30.0)
    held = replace(one, command=np.full_like(one.command, 0.3), position=np.zeros_like(one.position))
    creeps = Placement(catalog.load("effects", "coulomb", Effect).softer[0], ("pan",))
    entry = catalog.load("effects", effect, Effect)
    place = Placement(entry.creeping or entry, ("pan",))
    ends = [
        rollout(SimulatedRobot(ROBOT, places), np.array([numbers]), whole([held]))[0][0][-1, 0]
        for places, numbers in (((creeps,), [FRICTION, 0.02]), ((creeps, place), [FRICTION, 0.02, *values]))
    ]
    assert ends[1] == pytest.approx(ends[0], abs=1e-4)
    pulled = (creeps, Placement(catalog.load("effects", "constant_torque", Effect), ("pan",)))
    away = rollout(SimulatedRobot(ROBOT, pulled), np.array([[FRICTION, 0.02, 0.9 * FRICTION]]), whole([held]))[0][0][-1, 0]
    assert abs(away - ends[0]) > 1e-3
