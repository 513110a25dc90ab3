"""Open-loop replay of an emitted model gives the error that the fit saw, hook or no hook."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edream import catalog
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.sim.emit import emit
from edream.sim.robot import load_robot
from edream.sim.rollout import rollout
from edream.sim.simulation import Placement, Scaling, SimulatedRobot
from edream.sim.window import whole
from edream.stages.replay import replay

ROBOT = load_robot(Path(__file__).resolve().parents[2] / "edream" / "robots" / "pan_tilt.xml", site="ee")
CHOSEN = {"load_friction.slope[tilt]": 0.4, "stribeck.torque[pan]": 0.1, "stribeck.speed[pan]": 0.2}


def lossy() -> SimulatedRobot:
    load, stribeck = (catalog.load("effects", name, Effect) for name in ("load_friction", "stribeck"))
    return SimulatedRobot(ROBOT, (Placement(load, ("tilt",)), Placement(stribeck, ("pan",))))


def numbers() -> dict[str, float]:
    space = lossy().space
    return space.mapping(space.start()) | CHOSEN


def moves(name: str, pace: float, off: bool = False) -> Episode:
    """What a robot with load friction and stiction would have measured, torque off for a while where asked."""
    times = np.arange(0.0, 1.5, 0.02)
    command = np.stack([0.5 * np.sin(pace * times), 0.4 * np.sin(1.3 * pace * times) - 0.2], axis=1)
    enabled = ~((times > 0.6) & (times < 0.9)) if off else None
    still = Episode(name, ROBOT.joints, times, np.repeat(command[:1], len(times), axis=0), times, command, enabled=enabled)
    simulated = lossy()
    truth = rollout(simulated, simulated.space.vector(numbers())[None], whole([still]), threads=1)[0][0]
    # what starts at rest is told to start at rest: the first rows are alike
    return Episode(name, ROBOT.joints, times, truth, times, command, enabled=enabled)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("emitted")
    made = emit(lossy(), numbers())
    (folder / "model.xml").write_text(made.mjcf)
    (folder / "hook.py").write_text(made.hook or "")
    single = (made.hook or "").replace("def make_batch", "def _make_batch")
    (folder / "single.py").write_text(single)
    return folder


@pytest.mark.parametrize("off", [False, True])
def test_the_emitted_model_with_its_hook_replays_the_truth(written: Path, off: bool) -> None:
    episodes = [moves("slow", 3.0, off), moves("fast", 6.0, off)]
    robot = load_robot(written / "model.xml", site="ee")
    found = replay(robot, episodes, hook=written / "hook.py", threads=1)
    simulated = lossy()
    seen = rollout(simulated, simulated.space.vector(numbers())[None], whole(episodes), threads=1)
    error = np.concatenate([s[0][1:] - e.position[1:] for s, e in zip(seen, episodes, strict=True)])
    assert found["rmse_rad"] == pytest.approx(float(np.sqrt(np.mean(error**2))), abs=1e-7)
    without = replay(robot, episodes, threads=1)
    assert without["rmse_rad"] > 3.0 * found["rmse_rad"] + 1e-3
    assert set(found["per_episode"]) == {"slow", "fast"}
    assert found["translation_m"] < without["translation_m"] and found["rotation_rad"] < without["rotation_rad"]


@pytest.mark.parametrize("off", [False, True])
def test_a_hook_that_knows_no_batches_gives_the_same_errors(written: Path, off: bool) -> None:
    robot, episodes = load_robot(written / "model.xml", site="ee"), [moves("slow", 3.0, off)]
    many = replay(robot, episodes, hook=written / "hook.py", threads=1)
    one = replay(robot, episodes, hook=written / "single.py", threads=1)
    assert one["per_joint"]["tilt"]["rmse_rad"] == pytest.approx(many["per_joint"]["tilt"]["rmse_rad"], abs=1e-6)
    assert one["per_joint"]["pan"]["mae_rad"] == pytest.approx(many["per_joint"]["pan"]["mae_rad"], abs=1e-6)


def test_a_replay_says_what_it_takes_for_the_end_effector(written: Path) -> None:
    robots = [load_robot(written / "model.xml", site=site) for site in ("ee", None)]
    said = [replay(robot, [moves("slow", 3.0)], threads=1)["end_effector"] for robot in robots]
    assert said[0] == "site ee" and said[1].startswith("body ") and "the last" in said[1]


def test_only_the_chosen_joints_and_seconds_count(written: Path) -> None:
    robot, episodes = load_robot(written / "model.xml", site="ee"), [moves("slow", 3.0)]
    tilt = replay(robot, episodes, joints=["tilt"], until=1.0, threads=1)
    whole_motion = replay(robot, episodes, threads=1)
    assert tilt["rmse_rad"] == tilt["per_joint"]["tilt"]["rmse_rad"]
    assert tilt["rmse_rad"] != whole_motion["per_joint"]["tilt"]["rmse_rad"]


def test_an_unknown_joint_is_named_with_those_that_exist(written: Path) -> None:
    with pytest.raises(EdreamError, match="tilt"):
        replay(load_robot(written / "model.xml"), [moves("slow", 3.0)], joints=["tlit"])


def test_a_file_that_is_no_hook_ends_in_a_sentence(written: Path, tmp_path: Path) -> None:
    robot, episodes = load_robot(written / "model.xml"), [moves("slow", 3.0)]
    with pytest.raises(EdreamError, match="no hook"):
        replay(robot, episodes, hook=tmp_path / "absent.py")
    (tmp_path / "empty.py").write_text("x = 1\n")
    with pytest.raises(EdreamError, match="no function make"):
        replay(robot, episodes, hook=tmp_path / "empty.py")
    (tmp_path / "broken.py").write_text("x = (\n")
    with pytest.raises(EdreamError, match="cannot be imported: SyntaxError"):
        replay(robot, episodes, hook=tmp_path / "broken.py")


def test_a_recorded_gain_scales_the_replay() -> None:
    gain = Placement(catalog.load("effects", "servo_gain", Effect), ("tilt",), scaled={"kp": Scaling("firmware", 100.0)})
    weaker = SimulatedRobot(ROBOT, (gain,))
    still = replace(moves("slow", 3.0), conditions={"firmware": 50.0})
    moved = rollout(weaker, weaker.space.start()[None], whole([still]), threads=1)[0][0]
    recorded = replace(still, position=moved)
    with_gain = replay(ROBOT, [recorded], joints=["tilt"], threads=1, scaled={"servo_gain.kp": Scaling("firmware", 100.0)})
    assert with_gain["rmse_rad"] < 1e-3 < 5e-3 < replay(ROBOT, [recorded], joints=["tilt"], threads=1)["rmse_rad"]
    with pytest.raises(EdreamError, match="kq"):
        replay(ROBOT, [recorded], scaled={"servo_gain.kq": Scaling("firmware", 100.0)})
