"""Trials in the simulated workcell: what the policy is shown there, and which physics it meets."""

from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pyarrow as pa
import pytest

from edream import catalog, config, kinds
from edream.calibration.settings import RobotSettings
from edream.core.bench import bench_of
from edream.core.camera import pinhole
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.core.scene import Scene
from edream.practice.changing import Change, Scenes, changed_background, photos, tinted
from edream.practice.demonstrations import Demonstration
from edream.practice.dreaming import Dreaming, open_dreamed
from edream.practice.options import PolicyOptions, SftOptions
from edream.practice.rehearsing import RolloutOptions, calm, drawn_values, needs_of, shards_of
from edream.practice.trial import Chance
from edream.practice.twins import eye_of, twin_images
from edream.practice.worlds import CompositeEyes, RawEyes, Workcell, open_workcell, over
from edream.sim.camera import SimulationCamera
from edream.sim.emit import emit
from edream.sim.robot import RobotModel
from edream.sim.servo import places
from edream.sim.simulation import Placement, SimulatedRobot
from edream.stages.evaluate import worth_seeing
from edream.stages.twins import Beside
from edream.vision.dreamer import DreamModel
from edream.vision.trained import file_of
from edream.vision.variants import DREAM, DreamOptions, Part

SIZE = 48


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return config.read(config.compose(["robot=arm6"]).robot, RobotSettings, "robot").load()


@pytest.fixture(scope="module")
def cell(robot: RobotModel, rendering: None) -> Workcell:
    view = bench_of("arm6").view("cam_high")
    placed = {"cam_high": pinhole(SIZE, SIZE, view.fovy, np.array(view.pose))}
    return Workcell(
        "arm6", robot.mjcf, "grab_paper_cup", 25.0, ("cam_high",), SIZE, SIZE, dict(robot.assets), robot.site, placed=placed
    )


def test_a_twin_shows_what_the_simulator_s_eyes_show(cell: Workcell, robot: RobotModel) -> None:
    world = open_workcell(cell)
    seen = world.reset(5)
    plate = np.full((SIZE, SIZE, 3), (150, 110, 80), np.uint8)
    composite = CompositeEyes(plate).look(world, seen)["cam_high"]
    thing = world.scene.layout.thing("cup").proxy
    eye = eye_of(robot, cell.placed["cam_high"], Scene((thing,)), plate)
    found = eye.see(dict(zip(robot.joints, world.data.qpos[world._qpos], strict=True)), {"cup": world.state()["cup"]})
    twin = over(plate, found.colour, np.maximum(found.robot, found.object))
    eye.close()
    assert (found.object > 0).any() and (found.robot > 0).any()
    assert np.abs(twin.astype(float) - composite).mean() < 3.0
    assert np.abs(composite.astype(float) - plate).mean() > 3.0, "the comparison must be able to fail"
    raw = RawEyes().look(world, seen)["cam_high"]
    assert raw.shape == (SIZE, SIZE, 3) and not np.array_equal(raw, composite)
    world.close()


def test_dreamed_eyes_are_the_same_for_the_same_trial_and_remember_only_their_own(cell: Workcell, tmp_path: Path) -> None:
    options = DreamOptions(Part("pixel_unshuffle"), Part("unet", {"widths": [16, 24], "heads": 2}), Part("bridge", {"noise": 0.03}))
    model = DreamModel.of(options.codec, options.denoiser, options.objective, 3)
    path = tmp_path / file_of(DREAM)
    kinds.write({name: value.numpy() for name, value in model.denoiser.state_dict().items()}, path)
    plate = np.full((SIZE, SIZE, 3), 120, np.uint8)
    eyes = open_dreamed(Dreaming({file_of(DREAM): path}, options, plate, (0.0,) * 8, 3))
    world = open_workcell(cell)
    films = []
    for _ in range(2):
        seen = world.reset(5)
        eyes.begin(world, 0)
        films.append([eyes.look(world, seen)["cam_high"] for _ in range(2)])
    world.close()
    assert films[0][0].shape == (SIZE, SIZE, 3) and films[0][0].dtype == np.uint8
    assert all(np.array_equal(a, b) for a, b in zip(*films, strict=True))


def test_trials_of_one_start_are_spread_over_the_physics(cell: Workcell) -> None:
    shards = shards_of([cell, cell], range(4), 2, 3)
    turns = [turn for shard in shards for turn in shard.turns]
    assert sorted(turns) == [(start, sample) for start in range(4) for sample in range(2)]
    assert all(len(shard.turns) <= 3 for shard in shards)
    first = {turn for shard in shards[:2] for turn in shard.turns}
    assert all(sum((start, sample) in first for sample in range(2)) == 1 for start in range(4))


def test_needs_follow_from_physics_and_eyes_and_calm_leaves_nothing_to_chance() -> None:
    assert needs_of(RolloutOptions(model="published")) == ()
    assert needs_of(RolloutOptions(model="diagnose", eyes="dreamed")) == ("diagnose", "camera", "condition", "dream")
    assert needs_of(RolloutOptions(eyes="composite")) == ("fit", "camera", "masks")
    quiet = calm(RolloutOptions(noise=Chance(0.1, 0.1, 1.0, 0.2)))
    assert quiet.draws == 0 and quiet.noise == Chance()
    with pytest.raises(EdreamError, match=r"rollouts\.samples"):
        RolloutOptions(samples=1)


def test_physics_is_drawn_with_the_fit_s_correlation_and_only_where_the_data_tell() -> None:
    def estimate(value: float, low: float, high: float, status: str) -> dict[str, object]:
        return {"value": value, "interval": [low, high], "status": status}

    estimates = {
        "a": estimate(1.0, 0.8, 1.2, "converged"),
        "b": estimate(5.0, 0.0, 90.0, "not_identifiable"),
        "c": estimate(2.0, 1.6, 2.4, "converged"),
    }
    matrix = [[1.0, 0.0, -0.98], [0.0, 1.0, 0.0], [-0.98, 0.0, 1.0]]
    sets = drawn_values(estimates, {"names": ["a", "b", "c"], "values": matrix}, 200, 3)
    a, b, c = (np.array([one[name] for one in sets]) for name in ("a", "b", "c"))
    assert set(b.tolist()) == {5.0}
    assert np.corrcoef(a, c)[0, 1] < -0.9 and 0.05 < a.std() < 0.12
    assert (a >= 0.8).all() and (a <= 1.2).all()


def test_a_changed_scene_has_a_patch_in_the_bench_s_own_light_or_another_photo(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    plate = np.full((32, 40, 3), (150, 110, 80), np.uint8)
    plate[:16] //= 2
    one, two = (changed_background(plate, [], np.random.default_rng(4)) for _ in range(2))
    assert np.array_equal(one, two) and 0.01 < (one != plate).any(axis=2).mean() < 0.9
    changed = [(changed_background(plate, [], rng) != plate).any(axis=2).mean() for _ in range(20)]
    assert min(changed) < 0.2 < max(changed)
    cv2.imwrite(str(tmp_path / "a.png"), np.full((64, 64, 3), (10, 20, 30), np.uint8))
    others = photos(tmp_path, 32, 40)
    assert np.array_equal(changed_background(plate, others, rng), np.full((32, 40, 3), (30, 20, 10), np.uint8))
    with pytest.raises(EdreamError, match=r"sft\.change\.folder"):
        photos(tmp_path / "none", 32, 40)
    thing = np.zeros((32, 40), np.uint8)
    thing[:4] = 255
    assert np.array_equal(tinted(plate, thing, np.array([0.5, 1.0, 1.0]))[4:], plate[4:])
    assert (tinted(plate, thing, np.array([0.5, 1.0, 1.0]))[:4, :, 0] < plate[:4, :, 0]).all()


def test_a_twin_comes_with_masks_and_a_changed_scene_leaves_robot_and_things_where_they_are() -> None:
    times = np.arange(6) / 10.0
    episode = Episode("one", ("a",), times, np.zeros((6, 1)), times, np.zeros((6, 1)))
    shown = Demonstration("one", np.zeros((6, 1)), np.zeros((6, 1)), np.zeros((6, 1, 16, 16, 3), np.uint8), np.zeros((6, 0)))
    robot, thing = np.zeros((16, 16), np.uint8), np.zeros((16, 16), np.uint8)
    robot[:4], thing[4:8] = 255, 255
    seen = SimpleNamespace(colour=np.full((16, 16, 3), 90, np.uint8), robot=robot, object=thing)
    eye = SimpleNamespace(see=lambda joints, things: seen)
    scene = SimpleNamespace(at=lambda name, time: {"cup": np.zeros(7)})
    plate = np.full((16, 16, 3), 200, np.uint8)
    twin = twin_images(episode, shown, ("a",), eye, scene, PolicyOptions(height=16, width=16), plate)
    assert twin["images"].shape == (6, 1, 16, 16, 3) and twin["cover"].shape == twin["things"].shape == (6, 1, 16, 16)
    assert (twin["images"][:, 0, :8] == 90).all() and (twin["images"][:, 0, 8:] == 200).all()
    scenes = Scenes(Change(share=0.5, colour=0.3), plate, [np.full((16, 16, 3), number, np.uint8) for number in (10, 20)])
    many = {name: np.concatenate([one] * 20) for name, one in twin.items()}
    out = scenes.changed(many["images"], many["cover"], many["things"], np.random.default_rng(1))
    assert (out[:, 0, :4] == 90).all()
    behind = out[:, 0, 12, 0, 0]
    assert set(behind.tolist()) == {10, 20, 200} and 0.35 < (behind != 200).mean() < 0.65
    tints = out[behind != 200][:, 0, 5, 0].astype(int)
    assert len({tuple(row) for row in tints.tolist()}) > 20 and (out[behind == 200] == many["images"][behind == 200]).all()
    again = scenes.changed(many["images"], many["cover"], many["things"], np.random.default_rng(1))
    assert np.array_equal(out, again) and (many["images"][:, 0, 8:] == 200).all()


def test_scenes_cannot_change_where_nothing_says_what_is_scene() -> None:
    bare = Demonstration("one", np.zeros((6, 1)), np.zeros((6, 1)), np.zeros((6, 1, 16, 16, 3), np.uint8), np.zeros((6, 0)))
    with pytest.raises(EdreamError, match=r"'one' has no masks.*sft\.twins"):
        bare.masks_at(0)
    with pytest.raises(EdreamError, match=r"sft\.twins"):
        SftOptions(change=Change(share=0.5))


def test_films_show_failures_and_successes_in_turn() -> None:
    rows = [{"start": start, "success": start not in (3, 5)} for start in range(8)]
    table = pa.Table.from_pylist(rows)
    assert worth_seeing(table, 4) == [0, 1, 3, 5]
    assert worth_seeing(table, 6) == [0, 1, 2, 3, 4, 5]
    assert worth_seeing(table, 0) == []


def test_physics_may_come_from_other_recordings() -> None:
    elsewhere = RolloutOptions(model="diagnose", physics="data=motions ingest.fps=50")
    assert elsewhere.need == "diagnose data=motions ingest.fps=50" and elsewhere.need in needs_of(elsewhere)
    assert RolloutOptions(model="fit").need == "fit"
    assert not needs_of(RolloutOptions(model="published", physics="data=motions"))
    with pytest.raises(EdreamError, match=r"rollouts\.physics"):
        RolloutOptions(physics="motions")


def test_twins_stand_where_a_diagnosed_simulator_has_them(cell: Workcell, robot: RobotModel) -> None:
    wrong = Placement(catalog.load("effects", "gear_ratio", Effect), ("joint3",))
    zero = Placement(catalog.load("effects", "encoder_offset", Effect), ("joint2",))
    simulated = SimulatedRobot(robot, (wrong, zero))
    emitted = emit(
        simulated, {"gear_ratio.ratio[joint3]": 1.0, "gear_ratio.encoder[joint3]": 1.1, "encoder_offset.angle[joint2]": 0.2}
    )
    there = replace(robot, mjcf=emitted.mjcf)
    (arm,) = bench_of("arm6").arms
    truly = np.array([[*arm.home, arm.most]])
    reading = truly * [1, 1, 1.1, 1, 1, 1, 1] + [0, 0.2, 0, 0, 0, 0, 0]
    assert np.allclose(places(robot.model, robot.joints, reading), reading)
    standing = places(there.model, there.joints, reading)
    camera = cell.placed["cam_high"] if cell.placed else None
    assert camera is not None
    masks = []
    for model, joints in ((robot, truly), (there, standing), (robot, reading)):
        eye = SimulationCamera(model, camera)
        masks.append(eye.mask(dict(zip(model.joints, joints[0], strict=True))).astype(int))
        eye.close()
    assert np.abs(masks[1] - masks[0]).max() <= 64 and np.abs(masks[2] - masks[0]).mean() > 2.0


def test_only_a_diagnosis_makes_other_twins() -> None:
    settings = [asdict(Beside(model=model, physics=physics)) for model, physics in (("fit", "data=moves"), ("published", ""))]
    assert settings[0] == settings[1] and Beside(model="fit").needs == ()
    assert Beside(model="diagnose", physics="data=moves ingest.fps=50").needs == ("diagnose data=moves ingest.fps=50",)
