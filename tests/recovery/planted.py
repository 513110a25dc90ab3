"""A planted truth on arm6: motions that MuJoCo makes under known numbers, seen through a noisy encoder."""

from dataclasses import dataclass

import numpy as np

from edream import catalog, config
from edream.calibration.problem import Fitter, FitterOptions, Problem
from edream.calibration.settings import RobotSettings, SpaceSettings, simulated_robot
from edream.calibration.worth import Worth, worth_of
from edream.core.episode import Episode
from edream.sim.objective import Objective
from edream.sim.polish import finish
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from edream.sim.window import whole

NOISE = 5e-4  # rad
RATE = 50.0  # Hz
CENTRE = np.array([0.0, 1.2, 1.2, 0.0, 0.0, 0.0, 0.03])
REACH = np.array([0.8, 0.5, 0.5, 0.6, 0.5, 0.8, 0.02])
EFFECTS = ("servo_gain", "viscous", "coulomb", "armature")


@dataclass(frozen=True)
class Recovered:
    """One seed: the planted truth and what was found."""

    truth: dict[str, float]
    worth: Worth
    rms: float


def arm(effects: tuple[str, ...] = EFFECTS) -> SimulatedRobot:
    """arm6 with 24 unknown numbers: four effects on each of its six arm joints."""
    robot = RobotSettings(config.conf_folder().parent / "edream" / "robots" / "arm6.xml", "arm6", "ee").load()
    placed = tuple(f"{effect}@{joint}" for effect in effects for joint in robot.joints[:6])
    return simulated_robot(robot, SpaceSettings(effects=placed))


def commands(rng: np.random.Generator, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and commands of one motion: slow and fast sines on every joint, and steps."""
    times = np.arange(0.0, seconds, 1.0 / RATE)
    wave = np.zeros((len(times), 7))
    for joint in range(7):
        for frequency in (rng.uniform(0.1, 0.3), rng.uniform(0.4, 0.9), rng.uniform(1.2, 2.5)):
            wave[:, joint] += (
                rng.uniform(0.2, 0.5) / (1.0 + frequency) * np.sin(2 * np.pi * frequency * times + rng.uniform(0, 2 * np.pi))
            )
        wave[:, joint] += 0.25 * np.sign(np.sin(2 * np.pi * rng.uniform(0.15, 0.3) * times + rng.uniform(0, 2 * np.pi)))
    ramp = np.clip(times / 0.5, 0.0, 1.0)[:, None]
    return times, CENTRE + ramp * REACH * wave


def motions(simulated: SimulatedRobot, truth: np.ndarray, seed: int, count: int, seconds: float) -> list[Episode]:
    """Recordings of the arm with the planted numbers."""
    rng = np.random.default_rng(seed)
    bare = []
    for number in range(count):
        times, command = commands(rng, seconds)
        still = np.repeat(CENTRE[None], len(times), axis=0)
        bare.append(Episode(f"motion{number}", simulated.robot.joints, times, still, times, command))
    moved = rollout(simulated, truth, whole(bare))
    return [
        Episode(e.name, e.joints, e.times, m[0] + rng.normal(0.0, NOISE, m[0].shape), e.command_times, e.command)
        for e, m in zip(bare, moved, strict=True)
    ]


def plant(simulated: SimulatedRobot, seed: int) -> np.ndarray:
    """Numbers within a factor of two of the published ones."""
    rng = np.random.default_rng([seed, 1])
    space = simulated.space
    return np.clip(
        space.start() * np.exp(rng.uniform(-0.7, 0.7, len(space))),
        [p.low for p in space.parameters],
        [p.high for p in space.parameters],
    )


def recover(seed: int, count: int = 4, seconds: float = 8.0) -> Recovered:
    """Plant, record, fit from the published numbers as `edream calibrate` does."""
    simulated = arm()
    truth = plant(simulated, seed)
    objective = Objective(simulated, whole(motions(simulated, truth, seed, count, seconds)), np.arange(7) < 6)
    found = catalog.load("fitters", "gauss_newton", Fitter).fit(Problem(objective, options=FitterOptions()))
    solution = finish(objective, found.values, FitterOptions().polish)
    worth = worth_of(objective, solution.values, solution.residual, solution.jacobian)
    return Recovered(simulated.space.mapping(truth), worth, solution.rms)


def coverage(found: list[Recovered]) -> tuple[int, int, list[str]]:
    """How many identifiable parameters lie inside their interval, of how many, and those that do not."""
    inside, total, missed = 0, 0, []
    for number, one in enumerate(found):
        for name, estimate in one.worth.estimates.items():
            if estimate.status == "not_identifiable":
                continue
            total += 1
            good = estimate.interval[0] <= one.truth[name] <= estimate.interval[1]
            inside += good
            if not good:
                missed.append(
                    f"{number}: {name} {one.truth[name]:.4g} not in {estimate.interval[0]:.4g}..{estimate.interval[1]:.4g}"
                )
    return inside, total, missed
