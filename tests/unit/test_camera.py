"""Cameras: projection, what the simulation renders, files, and poses found from marks and silhouettes."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from edream.core.camera import Camera, as_json, from_json, looking_at, pinhole
from edream.core.episode import Episode, Video
from edream.core.errors import EdreamError
from edream.core.scene import SceneObject
from edream.sim.camera import SimulationCamera
from edream.sim.meshes import lightened
from edream.sim.robot import RobotModel
from edream.vision.pose import CameraGuess, Mark, fit_to_marks, fit_to_silhouettes, read_marks
from tests.rendering import camera_on, pan_tilt


def test_a_camera_looks_where_it_is_told_to() -> None:
    camera = pinhole(60, 80, 0.9, looking_at(np.array([1.0, -0.5, 0.6]), np.array([0.1, 0.2, 0.3])))
    assert np.allclose(camera.project(np.array([[0.1, 0.2, 0.3]])), [[40.0, 30.0]])
    above = camera.project(np.array([[0.1, 0.2, 0.4]]))[0]
    assert above[1] < 30.0, "what is higher in the room is higher in the image"


def test_a_point_behind_the_camera_has_no_pixel() -> None:
    camera = pinhole(60, 80, 0.9, looking_at(np.array([1.0, 0.0, 0.0]), np.zeros(3)))
    assert np.isnan(camera.project(np.array([[2.0, 0.0, 0.0]]))).all()


def test_resizing_keeps_the_view() -> None:
    camera = replace(pinhole(60, 80, 0.9, np.eye(4)), intrinsics=np.array([[70.0, 0, 35], [0, 65, 33], [0, 0, 1]]))
    points = np.array([[0.2, -0.1, 1.5]])
    assert np.allclose(camera.resized(120, 40).project(points), camera.project(points) * [0.5, 2.0])


def test_cameras_survive_a_file_and_bad_ones_are_refused() -> None:
    camera = camera_on()
    again = from_json(as_json({"top": camera}), "here")["top"]
    assert np.array_equal(again.pose, camera.pose) and np.array_equal(again.intrinsics, camera.intrinsics)
    bad = as_json({"top": camera})
    bad["top"]["extrinsics"][0][0] = 7.0
    with pytest.raises(EdreamError, match="no rotation"):
        from_json(bad, "here")
    with pytest.raises(EdreamError, match="'side' is unreadable"):
        from_json({"side": {"height": 3}}, "here")


@pytest.mark.usefixtures("rendering")
def test_what_is_rendered_lies_where_the_pinhole_says() -> None:
    matrix = np.array([[150.0, 0, 70], [0, 140, 65], [0, 0, 1]])
    camera = Camera(120, 160, matrix, looking_at(np.array([0.9, -0.4, 0.5]), np.array([0.0, 0.0, 0.1]), roll=0.3))
    ball = SceneObject("ball", "sphere", (0.012,), (1.0, 0.0, 0.0))
    eye = SimulationCamera(pan_tilt(), camera, [ball])
    for place in ([0.2, -0.25, 0.05], [-0.2, 0.3, 0.3]):
        seen = eye.see({"pan": 0.0, "tilt": 0.0}, {"ball": np.array([*place, 1.0, 0, 0, 0])}).object.astype(float)
        v, u = np.mgrid[0:120, 0:160] + 0.5
        centre = np.array([(u * seen).sum(), (v * seen).sum()]) / seen.sum()
        assert np.abs(centre - camera.project(np.array([place]))[0]).max() < 0.3
    eye.close()


@pytest.mark.usefixtures("rendering")
def test_the_robot_moves_in_the_image_and_hides_objects_behind_it() -> None:
    eye = SimulationCamera(pan_tilt(), camera_on(), [SceneObject("box", "box", (0.05, 0.05, 0.05), (0.0, 1.0, 0.0))])
    one, other = eye.see({"pan": 0.0, "tilt": 0.0}), eye.see({"pan": 1.0, "tilt": 0.5})
    assert one.robot.mean() > 5 and np.abs(one.robot.astype(int) - other.robot.astype(int)).mean() > 2
    assert not one.object.any()
    behind = eye.see({"pan": 0.0, "tilt": 0.0}, {"box": np.array([-0.1, 0.09, 0.1, 1, 0, 0, 0])})
    assert behind.object.any() and np.array_equal(behind.robot, one.robot)
    eye.close()


@pytest.mark.usefixtures("rendering")
def test_a_camera_that_moves_sees_each_frame_from_its_own_pose() -> None:
    still = camera_on()
    other = looking_at(np.array([0.1, 0.6, 0.4]), np.array([0.0, 0.0, 0.1]))
    moving, fixed = replace(still, pose=np.stack([still.pose, other])), replace(still, pose=other)
    assert moving.moves and not fixed.moves
    seen = {}
    for name, camera, frame in (("first", moving, 0), ("second", moving, 1), ("alone", fixed, 0)):
        eye = SimulationCamera(pan_tilt(), camera)
        seen[name] = eye.see({"pan": 0.4, "tilt": 0.2}, frame=frame)
        eye.close()
    assert np.array_equal(seen["second"].colour, seen["alone"].colour) and np.array_equal(seen["second"].robot, seen["alone"].robot)
    assert np.abs(seen["first"].robot.astype(int) - seen["second"].robot).mean() > 2


def test_osmesa_stands_in_for_egl_and_with_neither_the_answer_names_the_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    import mujoco.rendering.classic.gl_context as chosen

    from edream.sim import camera as cameras

    asked = []

    def without(missing: tuple[str, ...]) -> None:
        def find(name: str):
            asked.append(name)
            if name in missing:
                raise AttributeError("'NoneType' object has no attribute 'eglQueryString'")
            return SimpleNamespace(GLContext=name)

        monkeypatch.setattr(cameras, "import_module", find)

    for name in ("MUJOCO_GL", "DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(chosen, "GLContext", None)
    monkeypatch.setattr(cameras.platform, "system", lambda: "Linux")
    without(("mujoco.egl",))
    cameras.prepare_graphics()
    assert chosen.GLContext == "mujoco.osmesa" and asked == ["mujoco.egl", "mujoco.osmesa"]
    without(("mujoco.egl", "mujoco.osmesa"))
    with pytest.raises(EdreamError, match="libegl1, libgl1-mesa-dri and libopengl0, or libosmesa6 alone") as caught:
        SimulationCamera(pan_tilt(), camera_on(16))
    assert "eglQueryString" in str(caught.value) and "\n" not in str(caught.value)


def test_marks_that_are_damaged_are_a_sentence(tmp_path: Path) -> None:
    path = tmp_path / "marks.csv"
    head = b"episode,time,point,u,v\n"
    for data in (b"\xff\xfe\x00nonsense", head + b"one,0,ee,nan,3\n", head + b"one,0,ee\n", b"time,point\n1,ee\n"):
        path.write_bytes(data)
        with pytest.raises(EdreamError, match=r"marks\.csv") as caught:
            read_marks(path)
        assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("rendering")
def test_a_joint_that_the_robot_does_not_have_is_named() -> None:
    eye = SimulationCamera(pan_tilt(), camera_on(16))
    with pytest.raises(EdreamError, match="'tilt'"):
        eye.see({"tild": 0.0})
    eye.close()


def episode_seen_by(camera: Camera, images: np.ndarray, places: np.ndarray) -> Episode:
    times = np.arange(len(places)) / 10.0
    video = Video(times, camera.height, camera.width, lambda: iter(images))
    return Episode("one", ("pan", "tilt"), times, places, times, places, videos={"top": video})


def test_marked_points_give_back_the_camera_that_saw_them() -> None:
    robot, camera = pan_tilt(), camera_on(200)
    rng = np.random.default_rng(0)
    places = np.stack([np.linspace(-1.5, 1.5, 8), 0.9 * np.sin(np.arange(8))], axis=1)
    episode = episode_seen_by(camera, np.zeros((8, 200, 200, 3), np.uint8), places)
    data, marks = mujoco.MjData(robot.model), []
    for row, place in enumerate(places):
        data.qpos[:] = place
        mujoco.mj_kinematics(robot.model, data)
        for name in ("ee", "head"):
            point = (data.site if name == "ee" else data.body)(name).xpos
            u, v = camera.project(point[None])[0] + rng.normal(0, 0.3, 2)
            marks.append(Mark("one", row / 10.0, name, u, v))
    found, quality = fit_to_marks(robot, [episode], "top", marks)
    assert np.linalg.norm(found.pose[:3, 3] - camera.pose[:3, 3]) < 0.03
    assert abs(found.intrinsics[0, 0] / camera.intrinsics[0, 0] - 1.0) < 0.05
    assert quality["reprojection_error_px"] < 0.6
    with pytest.raises(EdreamError, match="at least 6"):
        fit_to_marks(robot, [episode], "top", marks[:3])


@pytest.mark.usefixtures("rendering")
def test_silhouettes_give_back_the_camera_from_a_rough_idea() -> None:
    robot, camera = pan_tilt(), camera_on(40)
    rng = np.random.default_rng(1)
    places = np.stack([rng.uniform(-2.0, 2.0, 7), rng.uniform(-1.0, 1.0, 7)], axis=1)
    eye = SimulationCamera(robot, camera)
    masks = np.stack([eye.mask({"pan": p, "tilt": t}) for p, t in places])
    eye.close()
    images = np.round(90 + masks[..., None] / 255.0 * np.array([80, 90, 100]) + rng.normal(0, 2, (7, 40, 40, 3))).astype(np.uint8)
    guess = CameraGuess(distance=0.7, azimuth=-25.0, elevation=20.0, fovy=50.0)
    found, quality = fit_to_silhouettes(robot, [episode_seen_by(camera, images, places)], "top", guess, 7, 700, seed=0)
    assert quality["silhouette_iou"] > 0.6, "of a thin moving outline; the true camera reaches 0.7"
    points = rng.uniform(-0.08, 0.15, (40, 3))
    assert np.sqrt(np.mean((found.project(points) - camera.project(points)) ** 2)) < 3.0


def dense_robot(rows: int = 60) -> RobotModel:
    """A link that is a bumpy mesh, away from its file's origin and turned."""
    up, around = np.linspace(0, np.pi, rows), np.linspace(0, 2 * np.pi, 2 * rows, endpoint=False)
    a, b = np.meshgrid(up, around, indexing="ij")
    size = 0.05 * (1 + 0.1 * np.sin(4 * b) * np.sin(3 * a))
    points = np.stack([size * np.sin(a) * np.cos(b), 2 * size * np.sin(a) * np.sin(b), size * np.cos(a)], -1).reshape(-1, 3)
    wide, lines = 2 * rows, [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points + [0.03, 0.01, 0.1]]
    for i in range(rows - 1):
        for j in range(wide):
            p, q = i * wide + j + 1, i * wide + (j + 1) % wide + 1
            lines += [f"f {p} {p + wide} {q}", f"f {q} {p + wide} {q + wide}"]
    mjcf = """<mujoco><asset><mesh name="link" file="link.obj" scale="1 1 1.5"/></asset><worldbody><body name="link">
      <joint name="turn" axis="0 0 1"/><geom type="mesh" mesh="link" quat="0.9 0.1 0.3 0" rgba="0.8 0.4 0.2 1"/></body></worldbody>
      <actuator><position joint="turn" kp="1"/></actuator></mujoco>"""
    return RobotModel("dense", mjcf, {"link.obj": "\n".join(lines).encode()})


def test_thinned_meshes_look_the_same_and_a_light_robot_stays_as_it_is(rendering: None) -> None:
    robot = dense_robot()
    thin = lightened(robot, 2000)
    assert int(robot.model.mesh_facenum.sum()) > 14000 and int(thin.model.mesh_facenum.sum()) <= 2100
    assert lightened(thin, 2500) is thin and thin.joints == robot.joints
    seen = []
    for one in (robot, thin):
        eye = SimulationCamera(one, camera_on(96))
        seen.append(eye.see({"turn": 0.7}))
        eye.close()
    masks = [one.robot > 127 for one in seen]
    assert (masks[0] & masks[1]).sum() / (masks[0] | masks[1]).sum() > 0.98 and masks[0].mean() > 0.02
    assert np.abs(seen[0].colour.astype(int) - seen[1].colour).mean() < 1.0


def test_torch_s_compiler_and_a_software_renderer_share_a_process(rendering, root: Path) -> None:
    pytest.importorskip("triton", reason="torch is here without its compiler")
    program = "from tests.rendering import why_not; assert why_not() is None; import torch._dynamo"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=200, cwd=root)
    assert done.returncode == 0, done.stderr
