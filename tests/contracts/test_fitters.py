"""What every fitter must do, run on each entry of the catalog without being told."""

from functools import cache

import numpy as np
import pytest

from edream import catalog, config
from edream.calibration.problem import Fitter, FitterOptions, Problem
from edream.calibration.settings import RobotSettings, SpaceSettings, simulated_robot
from edream.calibration.surrogate import Surrogate
from edream.calibration.windows import draw_windows, measured_sequences, simulate
from edream.core.episode import Episode
from edream.sim.objective import Objective
from edream.sim.rollout import rollout
from edream.sim.window import whole

NAMES = catalog.names("fitters")
TRUTH = {"servo_gain": 0.6, "viscous": 1.5}
OPTIONS = FitterOptions(iterations=6, polish=3, annealing_steps=60, evaluations=60, descent_steps=30, rounds=0)


@cache
def recorded() -> tuple[object, tuple[Episode, ...], np.ndarray]:
    """A pan-tilt head with a gain and a damping that are not the published ones."""
    robot = RobotSettings(config.conf_folder().parent / "edream" / "robots" / "pan_tilt.xml").load()
    simulated = simulated_robot(robot, SpaceSettings(tuple(TRUTH), (("all",),)))
    truth = simulated.space.start() * np.array(list(TRUTH.values()))
    times = np.arange(0.0, 3.0, 0.02)
    low, high = np.array([robot.model.joint(j).range for j in robot.joints]).T
    wave = np.stack([np.sin(3 * times), np.sign(np.sin(4 * times))], axis=1)
    command = (low + high) / 2 + 0.2 * (high - low) / 2 * wave
    bare = Episode("wave", robot.joints, times, np.repeat(command[:1], len(times), axis=0), times, command)
    return simulated, (Episode("wave", robot.joints, times, rollout(simulated, truth, whole([bare]))[0][0], times, command),), truth


def problem() -> Problem:
    simulated, episodes, _ = recorded()
    return Problem(Objective(simulated, whole(episodes), stride=2), options=OPTIONS, seed=4)


def solved(name: str):
    entry, one = catalog.load("fitters", name, Fitter), problem()
    if entry.needs_surrogate:
        simulated, episodes, _ = recorded()
        windows = draw_windows(episodes, 16, 8, np.random.default_rng(0))
        sweep = simulate(simulated, np.random.default_rng(1).uniform(0, 1, (16, 2)), windows)
        one.measured = measured_sequences(simulated, windows)
        one.surrogate = catalog.load("surrogates", "mlp", Surrogate).fit(sweep, {"hidden": 24, "members": 2, "epochs": 6}, 0)
    return entry.fit(one)


@pytest.mark.parametrize("name", NAMES)
def test_a_fit_comes_nearer_to_the_recordings_and_stays_in_the_box(name: str) -> None:
    simulated, _, _ = recorded()
    one = problem()
    start = float(one.cost(one.space.to_unit(one.space.start()))[0])
    found = solved(name)
    assert found.cost < 0.5 * start
    unit = simulated.space.to_unit(found.values)
    assert ((unit >= -1e-9) & (unit <= 1 + 1e-9)).all()
    assert found.simulations > 0 and len(found.history) > 1
    assert float(one.cost(unit)[0]) == pytest.approx(found.cost, rel=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_the_same_seed_gives_the_same_fit(name: str) -> None:
    assert np.array_equal(solved(name).values, solved(name).values)


def test_the_default_fitter_recovers_the_planted_numbers() -> None:
    assert solved("gauss_newton").values == pytest.approx(recorded()[2], rel=0.01)
