"""A two-joint arm whose recordings show what its model does, and fits of it that have an effect."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from benchmarks.blind.cases import robot_of
from edream.core.episode import Episode
from edream.diagnosis.candidates import Candidate, placement
from edream.diagnosis.descent import Fit, begin
from edream.diagnosis.nuisance import published
from edream.diagnosis.problem import Problem, Settings, nuisance_placements, prepare
from edream.diagnosis.screen import extend, with_quantities
from edream.diagnosis.trials import Trial
from edream.ingest.recordings import ingest_recordings
from edream.reality.truth import Truth, seal
from edream.record import RecordConfig, record
from edream.sim.robot import RobotModel
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot

NOISE = 3e-4  # of its measurements [rad]


def commanded(number: int, joints: tuple[str, ...], seconds: float = 4.0, jump: float = 0.0, jitter: float = 0.0) -> Episode:
    """A recording of two joints that did exactly as they were told: sines at 50 Hz, with jumps [rad] to and fro.

    Where the clock is off, by `jitter` [s], they begin at rest.
    """
    rng = np.random.default_rng(number)
    times = np.arange(0.0, seconds, 0.02)
    phase = rng.uniform(0.0, 6.0, 2)
    command = 0.5 * np.sin(times[:, None] * rng.uniform(1.0, 3.0, 2) + phase)
    command = command + jump * np.sign(np.sin(2.5 * times[:, None] + phase))
    if jitter:
        times[1:] += jitter * rng.normal(size=len(times) - 1)
        command = command * np.minimum(times[:, None], 1.0) ** 2
    return Episode(f"motion_{number}", joints, times, command, times, command)


def pan_tilt() -> RobotModel:
    """The arm."""
    robot = robot_of("pan_tilt")
    assert robot is not None
    return robot


def still_problem(robot: RobotModel | None = None, step: float | None = None, jump: float = 0.0, jitter: float = 0.0) -> Problem:
    """Five recordings in which nothing is hidden but the noise, and the time step [s] of the arm that made them.

    `jump` is how far commands jump to and fro [rad], `jitter` by how much their clock is off [s].
    """
    robot = robot or pan_tilt()
    bare = prepare(robot, [commanded(i, robot.joints, jump=jump, jitter=jitter) for i in range(5)], Settings())
    windows = (*bare.fitted, *bare.proof)
    moved = rollout(SimulatedRobot(replace(robot, step=step, timed=True), ()), np.zeros((1, 0)), windows)
    rng = np.random.default_rng(7)
    measured = [replace(w.episode, position=m[0] + rng.normal(0.0, NOISE, m[0].shape)) for w, m in zip(windows, moved, strict=True)]
    return prepare(robot, measured, Settings())


def held_still(robot: RobotModel, folder: Path, name: str, **set_up: float) -> Episode:
    """What is recorded of the make-believe robot without dry friction, set up so, as it holds all its joints at 0 for 2 s."""
    motion, known = folder / "hold.csv", folder / f"known-{name}.json"
    motion.write_text("time,tilt,pan\n0.0,0.0,0.0\n2.0,0.0,0.0\n")
    seal(Truth(robot.name, nuisance={"frictionloss": dict.fromkeys(robot.joints, 1e-9)}), known)
    record(robot, RecordConfig(folder / name, format="lerobot_v3", motions=2, motion=motion, truth=known, **set_up))
    (first, _), _ = ingest_recordings(folder / name, robot.joints)
    return first


def fit_of(problem: Problem) -> Fit:
    """The usual numbers, as published."""
    simulated = SimulatedRobot(problem.robot, nuisance_placements(problem))
    return begin(replace(published(problem), simulated=simulated), simulated.space.to_unit(simulated.space.start()))


def having(problem: Problem, fit: Fit, candidate: Candidate, quantities: Mapping[str, float]) -> Fit:
    """The same fit with an effect of given strength, nothing refitted."""
    place = placement(problem, candidate)
    extended, absent = extend(fit, [place])
    values = with_quantities(extended, absent, [place], [quantities])
    return begin(extended, extended.simulated.space.to_unit(values))


@dataclass(frozen=True)
class FitOf:
    """A fit of which only this is told."""

    name: str
    rms: float
    scale: float = 1.0
    objective: object = None
    residual: object = None
    ended: bool = False


def trial_of(effect: str, closed: float) -> Trial:
    """A candidate on `tilt`, surely that good, of whose fit the name is told."""
    return Trial(Candidate(effect, ("tilt",)), 0.0, FitOf(effect, 1.0), np.zeros(4), closed, True)  # type: ignore[arg-type]


def left_by(effect: str, left: float, closed: float = 0.9) -> Trial:
    """A candidate on `pan` that leaves so much of each of eight motions, squared, and surely closes a share of a gap."""
    fit = SimpleNamespace(rms=left**0.5, unit=np.zeros(3))
    return Trial(Candidate(effect, ("pan",)), 0.1, fit, np.full(8, left), closed, True)  # type: ignore[arg-type]
