"""Plates, grain, crops, clips: the parts that conditions are made of."""

from pathlib import Path

import numpy as np
import pytest

from edream.core.camera import looking_at, pinhole
from edream.core.errors import EdreamError
from edream.core.scene import ObjectTrack, Scene, SceneObject, scene_from_json, scene_json
from edream.vision.clips import Jitter, clip_of, images, starts
from edream.vision.frames import chosen_camera, frames_at, rows_at
from edream.vision.grain import Grain, measured_grain
from edream.vision.objects import Album, Crop, corners_of, moved
from edream.vision.plate import plate_of
from tests.dreams import small_scenes


def test_a_plate_forgets_an_object_that_moves_slowly_and_a_light_that_wanders() -> None:
    rng = np.random.default_rng(0)
    background = rng.integers(60, 180, (24, 24, 3)).astype(np.uint8)
    episodes, plain = [], []
    for number in range(8):
        real = np.repeat(background[None], 10, axis=0).astype(float) * rng.uniform(0.9, 1.1)
        y = 2 * number
        for t in range(10):
            real[t, y : y + 6, t // 5 + 8 : t // 5 + 14] = 250.0
        episodes.append((np.clip(real, 0, 255).astype(np.uint8), np.zeros((10, 24, 24), np.uint8)))
        plain.append(np.median(real, axis=0))
    error = np.abs(plate_of(episodes).astype(float) / background - 1.0)
    assert np.median(error) < 0.06 and error.max() < 0.25
    assert np.abs(plain[3] / background - 1.0).max() > 0.5, "a median over one episode keeps the object"


def test_a_plate_leaves_the_robot_out_where_the_place_is_ever_free() -> None:
    background = np.full((20, 20, 3), 100, np.uint8)
    real, robot = np.repeat(background[None], 12, axis=0), np.zeros((12, 20, 20), np.uint8)
    real[:8, 5:10, 5:10], robot[:8, 5:10, 5:10] = 230, 255  # there most of the time
    assert np.abs(plate_of([(real, robot)], each=12).astype(int) - 100).max() <= 2


def test_grain_is_measured_where_the_scene_moves_and_drifts() -> None:
    rng = np.random.default_rng(1)
    still = np.repeat(np.linspace(20, 230, 40)[None, :, None], 40, axis=0).repeat(3, axis=2)
    drift = 1.0 + 0.05 * np.sin(np.arange(40) / 9.0)
    clip = still[None] * drift[:, None, None, None] + rng.normal(0, 3.0, (40, 40, 40, 3))
    clip[:, 10:15, 10:15] = rng.integers(0, 255, (40, 5, 5, 3))
    levels = measured_grain([np.clip(np.round(clip), 0, 255).astype(np.uint8)]).levels
    assert np.allclose(levels[1:7], 3.0, atol=0.4)


def test_noise_of_a_grain_follows_brightness() -> None:
    grain = Grain((1.0,) * 4 + (3.0,) * 4)
    assert grain.at(np.array(10.0)) == 1.0 and grain.at(np.array(250.0)) == 3.0


def test_a_crop_lands_where_the_pose_puts_it() -> None:
    camera = pinhole(64, 64, 0.8, looking_at(np.array([1.0, -0.6, 0.8]), np.zeros(3)))
    box = SceneObject("box", "box", (0.06, 0.06, 0.06), (1.0, 0.0, 0.0))
    then, now = np.array([0.1, 0.0, 0.0, 1, 0, 0, 0]), np.array([-0.1, 0.15, 0.0, 1, 0, 0, 0])
    there, here = corners_of(box, then, camera), corners_of(box, now, camera)
    mask = np.zeros((64, 64), np.uint8)
    x, y = there.mean(axis=0).astype(int)
    mask[y - 4 : y + 5, x - 4 : x + 5] = 1
    _, share = moved(Crop(np.full((64, 64, 3), 200, np.uint8), mask, there), here, None)
    v, u = np.nonzero(share > 127)
    assert np.abs(np.array([u.mean(), v.mean()]) - here.mean(axis=0)).max() < 1.5


def test_a_crop_without_poses_takes_the_place_of_the_mask_but_not_its_pixels() -> None:
    colour, then, now = np.full((30, 30, 3), 200, np.uint8), np.zeros((30, 30), np.uint8), np.zeros((30, 30), np.uint8)
    then[5:11, 5:11], now[15:21, 18:24] = 1, 1
    made, share = moved(Crop(colour, then, None), None, now)
    assert ((share > 127) == (now > 0)).mean() > 0.99 and (made[now > 0] == 200).all()
    assert not moved(Crop(colour, then, None), None, np.zeros_like(now))[1].any()
    speck = now.copy()
    speck[2:5, 2:5] = 1
    assert np.array_equal(moved(Crop(colour, then, None), None, speck)[1], share), "a speck draws nothing away"


def drawn_box(camera, pose: np.ndarray, colours: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A box whose faces have colours of their own, as the camera sees it: image, mask, corners."""
    import cv2

    corners = corners_of(SceneObject("box", "box", (0.06, 0.06, 0.06), (1.0, 0.0, 0.0)), pose, camera)
    faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (1, 3, 7, 5)]
    image, mask = np.full((96, 96, 3), 90, np.uint8), np.zeros((96, 96), np.uint8)
    space = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.06
    angle = 2 * np.arctan2(pose[6], pose[3])
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    away = [np.linalg.norm(turn @ space[list(f)].mean(axis=0) + pose[:3] - camera.pose[:3, 3]) for f in faces]
    for number in np.argsort(away)[::-1]:  # far faces first
        points = np.round(corners[list(faces[number])]).astype(np.int32)
        cv2.fillConvexPoly(image, points, colours[number].tolist())
        cv2.fillConvexPoly(mask, points, 1)
    return image, mask, corners


def test_of_many_crops_the_one_that_shows_the_same_faces_is_taken_and_none_of_the_episode_itself() -> None:
    camera = pinhole(96, 96, 0.6, looking_at(np.array([1.0, -0.6, 0.8]), np.zeros(3)))
    colours = np.array([[230, 40, 40], [40, 230, 40], [40, 40, 230], [230, 230, 40], [230, 40, 230]], np.uint8)

    def turned(angle: float, x: float = 0.0) -> np.ndarray:
        return np.array([x, 0.0, 0.0, np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])

    crops = [Crop(*drawn_box(camera, turned(a), colours), f"episode_{i}") for i, a in enumerate(np.linspace(-3, 3, 25))]
    wrong = Crop(np.zeros((96, 96, 3), np.uint8), crops[0].mask, corners_of_turned(camera, turned(1.0, 0.05)), "itself")
    album = Album.of([*crops, wrong])
    assert album is not None
    image, mask, corners = drawn_box(camera, turned(1.0, 0.05), colours)
    colour, share = album.seen(corners, None, "itself")
    inside = (mask > 0) & (share > 127)
    assert inside.sum() / (mask > 0).sum() > 0.85
    assert np.abs(colour[inside].astype(int) - image[inside]).mean() < 25.0
    single, alone = moved(crops[0], corners, None)
    there = (mask > 0) & (alone > 127)
    assert np.abs(single[there].astype(int) - image[there]).mean() > 50.0, "one crop shows the wrong faces"
    assert not album.seen(corners, None)[0][inside].any(), "were its own episode asked, it would copy"


def corners_of_turned(camera, pose: np.ndarray) -> np.ndarray:
    return corners_of(SceneObject("box", "box", (0.06, 0.06, 0.06), (1.0, 0.0, 0.0)), pose, camera)


def test_crops_that_are_half_hidden_or_touch_the_edge_are_left_out() -> None:
    camera = pinhole(96, 96, 0.6, looking_at(np.array([1.0, -0.6, 0.8]), np.zeros(3)))
    image, mask, corners = drawn_box(camera, np.array([0.0, 0, 0, 1, 0, 0, 0]), np.full((5, 3), 200, np.uint8))
    hidden, edge = mask.copy(), mask.copy()
    hidden[:, : int(corners[:, 0].mean()) + 4] = 0
    edge[0, 0] = 1
    album = Album.of([Crop(image, m, corners) for m in (hidden, mask, edge)])
    assert album is not None and len(album.crops) == 1 and album.crops[0].mask is mask
    assert Album.of([Crop(image, np.zeros_like(mask), corners)]) is None


def test_scenes_of_objects_survive_a_file_and_bad_ones_are_refused() -> None:
    track = ObjectTrack(np.array([0.0, 1.0]), np.array([[0.0] * 3 + [1.0, 0, 0, 0], [1.0] * 3 + [1.0, 0, 0, 0]]))
    scene = Scene((SceneObject("cup", "cylinder", (0.03, 0.05), (1.0, 0.5, 0.0)),), {"one": {"cup": track}})
    again = scene_from_json(scene_json(scene), "here")
    assert np.allclose(again.at("one", 0.25)["cup"][:3], 0.25) and again.at("other", 0.0) == {}
    bad = scene_json(scene)
    bad["tracks"]["one"]["cup"]["times"] = [1.0, 0.0]
    with pytest.raises(EdreamError, match="rising times"):
        scene_from_json(bad, "here")
    with pytest.raises(EdreamError, match="'box'"):
        SceneObject("cup", "bxo", (1.0,), (0, 0, 0))


def test_clips_put_robot_over_background_and_object_over_both(tmp_path: Path) -> None:
    scenes = small_scenes(tmp_path)
    clip = clip_of(scenes, [(0, 0, "real")], 4)
    layers, real = scenes.layers[0], images(scenes.layers[0]["real"][:4])
    thing, robot = layers["masks"][:4, ..., 1] > 127, layers["masks"][:4, ..., 0] > 127
    composite = clip.composite[0].movedim(1, -1).numpy()
    assert np.allclose(composite[thing], real.movedim(1, -1).numpy()[thing])
    plate = images(scenes.references[0]).movedim(0, -1).numpy()
    assert np.allclose(composite[~thing & ~robot], np.broadcast_to(plate, composite.shape)[~thing & ~robot])


@pytest.mark.parametrize("source", ["sim", "crop", "none"])
def test_no_pixel_of_the_target_is_copied_unless_the_source_is_real(tmp_path: Path, source: str) -> None:
    scenes = small_scenes(tmp_path)
    before = clip_of(scenes, [(0, 0, source)], 4)
    scenes.layers[0]["real"][:] = 7
    after = clip_of(scenes, [(0, 0, source)], 4)
    assert bool((before.composite == after.composite).all()) and bool((before.object == after.object).all())


def test_jitter_changes_the_object_layer_alone(tmp_path: Path) -> None:
    scenes, jitter = small_scenes(tmp_path), Jitter(colour=0.3, shift=2, drop=0.0)
    plain = clip_of(scenes, [(0, 0, "sim")], 4)
    shaken = clip_of(scenes, [(0, 0, "sim")], 4, jitter, np.random.default_rng(3))
    free = ((plain.object + shaken.object) == 0).expand_as(plain.composite)
    assert bool((plain.composite[free] == shaken.composite[free]).all())
    assert not bool((plain.composite == shaken.composite).all()) and bool((plain.real == shaken.real).all())


def test_training_never_meets_a_held_out_episode(tmp_path: Path) -> None:
    scenes = small_scenes(tmp_path)
    assert {n for n, _ in starts(scenes, 4, True, 2)} == {2} and {n for n, _ in starts(scenes, 4, False, 2)} == {0, 1}
    with pytest.raises(EdreamError, match="lower dream"):
        starts(scenes, 40, True, 2)


def test_images_are_taken_at_the_rate_that_is_asked_for(tmp_path: Path) -> None:
    from edream.core.episode import Video

    times = np.arange(50) / 50.0 + np.random.default_rng(0).normal(0, 0.001, 50)
    video = Video(times, 4, 4, lambda: iter(np.arange(50, dtype=np.uint8)[:, None, None, None] * np.ones((4, 4, 3), np.uint8)))
    rows = rows_at(video, 10.0)
    assert np.array_equal(rows, np.arange(0, 50, 5))
    assert [int(image[0, 0, 0]) for image in frames_at(video, rows, 2, 2)] == rows.tolist()
    with pytest.raises(EdreamError, match="'front'"):
        chosen_camera(("front", "wrist"), "frnt")
