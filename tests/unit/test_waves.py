"""Where an effect is probed: at every length of a ripple that the travel can tell, and at places that the motions went to."""

from dataclasses import replace

import numpy as np

from benchmarks.blind.cases import robot_of
from edream.core.episode import Episode
from edream.diagnosis.candidates import Candidate, placement, probes_of
from edream.diagnosis.descent import begin
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.screen import Scored, scanned, screen
from edream.effects.cogging import PERIODS
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from edream.sim.window import whole

TRUE = {"amplitude": 0.12, "periods": 26.0, "phase": 0.8}


def motion(number: int, joints: tuple[str, ...]) -> Episode:
    rng = np.random.default_rng(number)
    times = np.arange(0.0, 5.0, 0.02)
    command = 1.2 * np.sin(times[:, None] * rng.uniform(0.8, 1.6, 2) + rng.uniform(0.0, 6.0, 2)) * [1.6, 0.8]
    return Episode(f"motion_{number}", joints, times, command, times, command)


def test_a_ripple_between_two_coarse_lengths_is_found() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    windows = whole([motion(n, robot.joints) for n in range(4)])
    rippled = SimulatedRobot(
        robot, (placement(prepare(robot, [w.episode for w in windows], Settings()), Candidate("cogging", ("pan",))),)
    )
    moved = rollout(rippled, np.array([[TRUE[name] for name in ("amplitude", "periods", "phase")]]), windows)
    noise = np.random.default_rng(1)
    episodes = [
        replace(w.episode, position=m[0] + noise.normal(0.0, 2e-4, m[0].shape)) for w, m in zip(windows, moved, strict=True)
    ]
    problem = prepare(robot, episodes, Settings(effects=("cogging",)))
    fit = fit_nuisance(problem)
    fit = begin(fit.objective, fit.unit)
    coarse = Scored(Candidate("cogging", ("pan",)), {"amplitude": 0.05, "periods": 16.0, "phase": 0.0}, 0.1)
    assert min(abs(TRUE["periods"] - p) for p in PERIODS) >= 2.0
    assert abs(scanned(problem, fit, coarse).start["periods"] - TRUE["periods"]) < 0.5
    best = screen(problem, fit)[0]
    assert best.candidate == coarse.candidate and best.share > 0.6


def test_effects_that_have_a_place_are_probed_where_the_joint_moved() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    low, high = 0.6, 0.8
    own = tuple(robot.model.joint("tilt").range)
    episodes = [motion(n, robot.joints) for n in range(4)]
    column = robot.joints.index("tilt")
    for episode in episodes:
        episode.position[:, column] = np.linspace(low, high, len(episode.times))
    problem = prepare(robot, episodes, Settings())
    place = placement(problem, Candidate("position_friction", ("tilt",)))
    box = next(p for p in place.effect.parameters(robot.model, ("tilt",)) if p.name == "width")
    probes = probes_of(problem, place)
    assert all(low <= probe["centre"] <= high for probe in probes)
    assert len({probe["centre"] for probe in probes}) >= 5
    assert all(box.low <= probe["width"] <= box.high for probe in probes)
    assert tuple(robot.model.joint("tilt").range) == own
