"""Every task: its expert does it, by contact alone, in the simulator and in the make-believe reality; doing nothing does not."""

import mujoco
import numpy as np
import pytest

from edream import catalog
from edream.core.bench import BENCHES
from edream.reality.workcell import RealWorkcell
from edream.sim.workcell import SimulatedWorkcell
from tests.workcells import hidden, played, robot, task

TASKS = catalog.names("tasks")


@pytest.mark.parametrize("name", TASKS)
def test_the_expert_does_it_in_the_simulator(name: str) -> None:
    world = SimulatedWorkcell(robot(), task(name))
    assert sum(played(world, "arm6", name, range(6))) >= 5


@pytest.mark.parametrize("name", TASKS)
def test_the_expert_does_it_in_reality_within_the_time(name: str) -> None:
    world = RealWorkcell(robot(), hidden(), task(name))
    assert all(played(world, "arm6", name, range(2)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", TASKS)
def test_the_expert_does_nine_of_ten_starts_in_reality(name: str, seed: int) -> None:
    world = RealWorkcell(robot(), hidden(seed=seed), task(name))
    assert sum(played(world, "arm6", name, range(20))) >= 18


@pytest.mark.parametrize("name", TASKS)
def test_two_arms_do_it_one_at_a_time(name: str) -> None:
    world = SimulatedWorkcell(robot("cobot"), task(name))
    assert world.actions == 14
    assert {task(name).layout(start, world.bench.arms).arm for start in range(6)} == {0, 1}
    assert sum(played(world, "cobot", name, range(2))) == 2


@pytest.mark.parametrize("name", TASKS)
def test_nothing_done_is_no_success(name: str) -> None:
    world = SimulatedWorkcell(robot(), task(name))
    for start in range(5):
        seen = world.reset(start)
        assert not world.outcome().success and not world.outcome().grasped
        for _ in range(25):
            seen = world.step(seen.joints)
        assert not world.outcome().success and not world.outcome().grasped


@pytest.mark.parametrize("name", TASKS)
def test_a_start_means_the_same_places_in_both_worlds(name: str) -> None:
    simulated, real = SimulatedWorkcell(robot(), task(name)), RealWorkcell(robot(), hidden(), task(name))
    for start in (3, 99):
        simulated.reset(start)
        real.reset(start)
        one, two = simulated.state(), real.state()
        assert one.keys() == two.keys()
        for thing in one:
            np.testing.assert_allclose(one[thing][:3], two[thing][:3], atol=1.5e-3)
            assert abs(one[thing][3:] @ two[thing][3:]) > 0.9995


@pytest.mark.parametrize("name", TASKS)
def test_starts_differ_and_things_lie_apart_on_the_table(name: str) -> None:
    arms = BENCHES["arm6"].arms
    places = np.array([[thing.pose[:2] for thing in task(name).layout(start, arms).things] for start in range(100)])
    assert (places.reshape(100, -1).std(axis=0) > 0.01).all()
    if places.shape[1] == 2:
        assert np.linalg.norm(places[:, 0] - places[:, 1], axis=1).min() > 0.07


@pytest.mark.parametrize("name", TASKS)
def test_nothing_is_welded_and_fingers_hold_by_friction_alone(name: str) -> None:
    for world in (SimulatedWorkcell(robot(), task(name)), RealWorkcell(robot(), hidden(), task(name))):
        model = world.model if isinstance(world, SimulatedWorkcell) else world.session.model
        assert model.neq == 0 and model.ntendon == 0
        free = [thing.name for thing in world.scene.layout.things if not thing.fixed]
        assert (model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)).sum() == len(free)


def test_a_cup_slips_where_fingers_have_no_friction() -> None:
    world = SimulatedWorkcell(robot(), task("grab_paper_cup"), grip=0.002)
    assert not any(played(world, "arm6", "grab_paper_cup", range(2)))
