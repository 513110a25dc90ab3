"""Worlds: what they show, that they repeat themselves, and that reality moves among things as it moves alone."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edream.core.bench import Arm, bench_of
from edream.core.camera import looking_at, pinhole
from edream.core.errors import EdreamError
from edream.core.policy import StartNoise
from edream.reality.cell_look import CellLook, placed_cameras
from edream.reality.motions import commands
from edream.reality.recorder import perform
from edream.reality.session import Session, hollow
from edream.reality.truth import draw, seal, unseal
from edream.reality.workcell import RealWorkcell
from edream.sim.eyes import Images
from edream.sim.reach import Reach
from edream.sim.robot import RobotModel
from edream.sim.workcell import SimulatedWorkcell
from tests.workcells import hidden, robot, task

ROOT = Path(__file__).parents[2]
VIEWS = ("cam_high", "cam_side", "wrist")


def moves(world: SimulatedWorkcell | RealWorkcell, count: int = 8) -> np.ndarray:
    rng = np.random.default_rng(4)
    return world.low + (world.high - world.low) * rng.uniform(0.3, 0.6, (count, world.actions))


def seen_in(world: SimulatedWorkcell | RealWorkcell, start: int, noise: StartNoise | None = None) -> list[np.ndarray]:
    shown, parts = world.reset(start, noise), []
    for action in moves(world):
        parts += [shown.joints, *(shown.images[name] for name in sorted(shown.images))]
        shown = world.step(action)
    return [*parts, shown.joints, *(shown.images[name] for name in sorted(shown.images))]


def test_a_simulated_world_repeats_itself_bit_for_bit(rendering: None) -> None:
    world = SimulatedWorkcell(robot(), task(), images=Images(("cam_high",), 32, 32))
    one = seen_in(world, 5)
    seen_in(world, 6)
    assert all(np.array_equal(a, b) for a, b in zip(one, seen_in(world, 5), strict=True))
    other = SimulatedWorkcell(robot(), task(), images=Images(("cam_high",), 32, 32))
    assert all(np.array_equal(a, b) for a, b in zip(one, seen_in(other, 5), strict=True))


def test_reality_repeats_itself_bit_for_bit(rendering: None) -> None:
    world = RealWorkcell(robot(), hidden(), task(), look=CellLook(("cam_high",), 32, 32))
    one = seen_in(world, 5)
    seen_in(world, 6)
    assert all(np.array_equal(a, b) for a, b in zip(one, seen_in(world, 5), strict=True))


def test_a_reality_that_is_forgotten_unclosed_spoils_none_after_it(rendering: None) -> None:
    """In a process of its own: a graphics context that another test has left would hide it."""
    script = """
from edream.reality.cell_look import CellLook
from edream.reality.workcell import RealWorkcell
from edream.sim.camera import graphics
from tests.workcells import hidden, robot, task
with graphics():
    for _ in range(3):
        world = RealWorkcell(robot(), hidden(), task(), look=CellLook(("cam_high",), 32, 32))
        print(world.reset(5).images["cam_high"].tobytes().hex())
"""
    told = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=120)
    images = told.stdout.split()
    assert len(images) == 3 and len(set(images)) == 1, told.stderr


def test_reality_shows_the_same_whether_or_not_one_looked_before_and_nothing_of_what_is_over(rendering: None) -> None:
    world = RealWorkcell(robot(), hidden(), task(), look=CellLook(("cam_high",), 32, 32))
    last = seen_in(world, 5)[-1]
    begun = world.reset(5)
    for action in moves(world):
        shown = world.step(action)
    assert list(begun.images) == ["cam_high"]
    assert np.array_equal(shown.images["cam_high"], last)
    with pytest.raises(EdreamError, match="look before the next step"):
        _ = begun.images["cam_high"]


def test_noise_makes_trials_of_one_start_differ_and_repeats_with_its_seed() -> None:
    world = SimulatedWorkcell(robot(), task())
    plain, one = seen_in(world, 5), seen_in(world, 5, StartNoise(0.02, 0.005, seed=1))
    place = world.state()["cup"].copy()
    again, two = seen_in(world, 5, StartNoise(0.02, 0.005, seed=1)), seen_in(world, 5, StartNoise(0.02, 0.005, seed=2))
    assert np.abs(plain[0] - one[0]).max() > 1e-3
    assert np.abs(one[0] - two[0]).max() > 1e-3
    assert np.array_equal(one[-1], again[-1])
    assert np.abs(place - world.state()["cup"]).max() > 1e-4


@pytest.mark.parametrize("size", [(48, 64), (64, 64)])
def test_images_have_the_size_and_views_asked_for(rendering: None, size: tuple[int, int]) -> None:
    for world in (
        SimulatedWorkcell(robot(), task(), images=Images(VIEWS, *size)),
        RealWorkcell(robot(), hidden(), task(), look=CellLook(VIEWS, *size)),
    ):
        seen = world.reset(0)
        assert set(seen.images) == set(VIEWS)
        for image in seen.images.values():
            assert image.shape == (*size, 3) and image.dtype == np.uint8 and image.std() > 5.0
        world.close()


def test_conditions_tell_robot_and_things_apart(rendering: None) -> None:
    world = SimulatedWorkcell(robot(), task(), images=Images(("cam_side",), 96, 96, raw=False, supersampling=2))
    world.reset(0)
    shown = world.conditions()["cam_side"]
    assert (shown.robot > 0).mean() > 0.02 and (shown.object > 0).mean() > 0.005
    assert not ((shown.robot == 255) & (shown.object == 255)).any()
    assert (shown.composite[(shown.robot == 0) & (shown.object == 0)] == 0).all()
    assert shown.composite[shown.object == 255].mean() > 100  # the cup is pale


def test_a_cutout_is_what_the_conditions_show_in_half_the_renderings(rendering: None) -> None:
    world = SimulatedWorkcell(robot(), task(), images=Images(("cam_high", "cam_side"), 64, 64, raw=False))
    world.reset(3)
    rng = np.random.default_rng(0)
    for _ in range(5):
        world.step(rng.uniform(world.low, world.high))
        shown = world.conditions()
        for name, (colour, share) in world.cutouts().items():
            assert np.array_equal(colour, shown[name].composite)
            assert np.array_equal(share, np.maximum(shown[name].robot, shown[name].object)) and 0.02 < (share > 0).mean() < 0.9
    world.close()


def test_where_a_cup_is_seen_is_where_the_camera_says(rendering: None) -> None:
    camera = pinhole(96, 96, 0.7, looking_at(np.array([0.9, -0.2, 0.5]), np.array([0.3, 0.0, 0.05])))
    images = Images(("cam_high",), 96, 96, placed={"cam_high": camera}, raw=False)
    world = SimulatedWorkcell(robot(), task(), images=images)
    for start in (1, 2):
        world.reset(start)
        rows, columns = np.nonzero(world.conditions()["cam_high"].object > 127)
        (u, v) = camera.project(world.state()["cup"][None, :3])[0]
        assert abs(columns.mean() + 0.5 - u) < 2.5 and abs(rows.mean() + 0.5 - v) < 2.5


def test_actions_that_no_actuator_takes_are_refused() -> None:
    for world in (SimulatedWorkcell(robot(), task()), RealWorkcell(robot(), hidden(), task())):
        with pytest.raises(EdreamError):
            world.step(np.zeros(3))
        with pytest.raises(EdreamError):
            world.step(np.full(7, np.nan))


def test_a_view_or_robot_that_does_not_exist_is_named() -> None:
    with pytest.raises(EdreamError, match="cam_low"):
        SimulatedWorkcell(robot(), task(), images=Images(("cam_low",)))
    other = RobotModel("pan", robot().mjcf)
    with pytest.raises(EdreamError, match="no workcell"):
        SimulatedWorkcell(other, task())


def test_a_hook_file_acts_in_the_workcell(tmp_path: Path) -> None:
    hook = tmp_path / "hook.py"
    push = "data.qfrc_applied[model.joint('joint1').dofadr[0]] = 10.0"
    hook.write_text(f"def make(model):\n    def step(model, data):\n        {push}\n    return step\n")
    plain, pushed = SimulatedWorkcell(robot(), task()), SimulatedWorkcell(robot(), task(), hook=hook)
    assert pushed.reset(0).joints[0] - plain.reset(0).joints[0] > 0.02


@pytest.mark.parametrize(
    "effects",
    [(), ("load_friction",), ("actuator_delay", "payload"), ("asymmetric_coulomb", "stribeck"), ("slew_limit", "sensor_delay")],
)
def test_reality_among_things_moves_as_reality_alone(effects: tuple[str, ...]) -> None:
    """The same hidden robot by MuJoCo's integrator with contacts and by reality's own: within a tenth of a degree."""
    arm = robot()
    truth = draw(arm, effects, np.random.default_rng(3))
    wanted = commands(arm.model, np.random.default_rng(5), 1, 3.0, 50.0)[0]
    times = np.arange(len(wanted)) / 50.0
    alone = perform(arm, truth, times[None], wanted[None], 0.0005, 1.0)
    clock, encoder = np.arange(len(alone.encoder)) * 0.0005 - 1.0, alone.encoder[:, 0]
    for term in truth.terms(arm.model):
        encoder = term.record(encoder, clock)
    expected = np.stack([np.interp(times, clock, column) for column in encoder.T], axis=1)
    spec = arm.spec()
    hollow(spec, truth, arm.model, 0.001)
    session = Session(spec.compile(), list(arm.joints), truth, arm.model)
    session.rest(wanted[0], 1.0)
    found = [session.encoder()]
    for row, time in zip(wanted[:-1], times[1:], strict=True):
        session.run(row, 1.0 + time)
        found.append(session.encoder())
    assert np.abs(np.array(found) - expected).max() < 1.8e-3


def test_shafts_that_give_are_refused_among_things() -> None:
    with pytest.raises(EdreamError, match="backlash"):
        RealWorkcell(robot(), hidden(effects=("backlash",)), task())


def test_smooth_friction_is_refused_among_things() -> None:
    with pytest.raises(EdreamError, match=r"leave record\.smooth at 0"):
        RealWorkcell(robot(), replace(hidden(), smooth=0.01), task())


def test_the_truth_of_a_workcell_survives_its_seal(tmp_path: Path) -> None:
    truth = hidden()
    seal(truth, tmp_path / "truth.json")
    assert unseal(tmp_path / "truth.json") == truth
    assert truth.cell["grip"] < 1.0


def test_cameras_of_reality_stand_a_little_elsewhere() -> None:
    bench = bench_of("arm6")
    placed = placed_cameras(bench, CellLook(VIEWS), 7)
    assert set(placed) == set(VIEWS)
    off = np.linalg.norm(placed["cam_high"].pose[:3, 3] - bench.views["cam_high"].pose[:3, 3])
    assert 1e-4 < off < 0.03


def test_inverse_kinematics_finds_back_to_a_pose() -> None:
    reach = Reach(robot().model, robot_arm())
    goal = np.array([0.3, 1.7, 1.1, 0.2, 0.5, -0.3])
    pos, turn = reach.pose(goal)
    found = reach.solve(pos, turn, np.array(robot_arm().home), 200)
    here, axes = reach.pose(found)
    assert np.linalg.norm(here - pos) < 5e-4 and np.abs(axes - turn).max() < 5e-3


def robot_arm() -> Arm:
    return bench_of("arm6").arms[0]
