"""Where a camera stands, from points marked by hand or from the robot's silhouettes."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import mujoco
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from edream.core.camera import Camera, looking_at
from edream.core.episode import Episode
from edream.core.errors import EdreamError, unknown_name
from edream.sim.camera import SimulationCamera
from edream.sim.followers import Followers
from edream.sim.meshes import lightened
from edream.sim.robot import RobotModel
from edream.vision.frames import frames_at, positions_at

SIZE = 64  # pixels along the longer side at which silhouettes are compared
COLUMNS = ("episode", "time", "point", "u", "v")
TRIANGLES = 20000  # of a robot whose silhouette is enough


@dataclass(frozen=True)
class CameraGuess:
    """A rough idea of where the camera stands, to within some 30 degrees and a third of the distance.

    Attributes:
        distance: from the robot's base [m]; None for three times its size.
        azimuth: the camera's direction seen from the base, 0 in front (+x), 90 to its left (+y) [degree]; None to try all around.
        elevation: above the horizon [degree].
        fovy: vertical field of view [degree].
    """

    distance: float | None = None
    azimuth: float | None = None
    elevation: float = 25.0
    fovy: float = 50.0


@dataclass(frozen=True)
class Mark:
    """A point of the robot that somebody found in an image: a site or body name, and its pixel; None stands for every camera."""

    episode: str
    time: float
    point: str
    u: float
    v: float
    camera: str | None = None


def read_marks(path: Path) -> list[Mark]:
    """Marked points from CSV with the columns episode, time [s], point (a site or a body of the robot), u, v [pixel], and camera
    where there are several.

    Raises:
        EdreamError: the file or a column is missing, or a number cannot be read.
    """
    if not path.is_file():
        raise EdreamError(f"There is no file of marked points at {path}; expected CSV with the columns {', '.join(COLUMNS)}.")
    try:
        rows = csv.DictReader(io.StringIO(path.read_text(encoding="utf-8-sig"), newline=""))
        return [Mark(r["episode"], _finite(r["time"]), r["point"], _finite(r["u"]), _finite(r["v"]), r.get("camera")) for r in rows]
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise EdreamError(
            f"{path} cannot be read as marked points ({error}); expected the columns {', '.join(COLUMNS)}."
        ) from error


def _finite(text: str) -> float:
    value = float(text)
    if not np.isfinite(value):
        raise ValueError(f"{text!r} is no finite number")
    return value


def fit_to_marks(robot: RobotModel, episodes: Sequence[Episode], name: str, marks: Sequence[Mark]) -> tuple[Camera, dict[str, Any]]:
    """Pinhole pose and focal length that put the robot's points where they were marked, and the error that is left [pixel].

    The pose starts from a PnP solution for each of several focal lengths (OpenCV, SQPnP), then least squares refines all seven
    numbers.

    Raises:
        EdreamError: fewer than six marks, an unknown episode or point, or no pose explains them.
    """
    marks = [one for one in marks if one.camera in (None, "", name)]
    if len(marks) < 6:
        raise EdreamError(
            f"There are {len(marks)} marked points for camera {name!r}; a camera's pose and focal length need at least 6."
        )
    points, pixels = _marked(robot, {e.name: e for e in episodes}, marks)
    video = episodes[0].videos[name]
    h, w = video.height, video.width
    best: tuple[float, np.ndarray] | None = None
    for focal in h * np.geomspace(0.5, 4.0, 13):
        matrix = np.array([[focal, 0, w / 2], [0, focal, h / 2], [0, 0, 1.0]])
        ok, turn, shift = cv2.solvePnP(points, pixels, matrix, np.zeros(4), flags=cv2.SOLVEPNP_SQPNP)
        if ok:
            found = least_squares(_mark_errors, np.r_[turn.ravel(), shift.ravel(), np.log(focal)], args=(points, pixels, h, w))
            if best is None or found.cost < best[0]:
                best = (float(found.cost), found.x)
    if best is None:
        raise EdreamError("No camera pose explains the marked points; check that they are not all on one line, and their order.")
    turn, shift, focal = Rotation.from_rotvec(best[1][:3]).as_matrix(), best[1][3:6], np.exp(best[1][6])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.T, -turn.T @ shift
    camera = Camera(h, w, np.array([[focal, 0, w / 2], [0, focal, h / 2], [0, 0, 1.0]]), pose)
    error = float(np.sqrt(np.mean(np.sum((camera.project(points) - pixels) ** 2, axis=1))))
    return camera, {"reprojection_error_px": error, "points": len(marks)}


def _mark_errors(x: np.ndarray, points: np.ndarray, pixels: np.ndarray, h: int, w: int) -> np.ndarray:
    seen = Rotation.from_rotvec(x[:3]).apply(points) + x[3:6]
    depth = np.maximum(seen[:, 2:], 1e-3)
    return (np.exp(x[6]) * seen[:, :2] / depth + [w / 2, h / 2] - pixels).ravel()


def _marked(robot: RobotModel, episodes: dict[str, Episode], marks: Sequence[Mark]) -> tuple[np.ndarray, np.ndarray]:
    model, data = robot.model, mujoco.MjData(robot.model)
    sites = [model.site(i).name for i in range(model.nsite)]
    bodies = [model.body(i).name for i in range(1, model.nbody)]
    points = []
    for mark in marks:
        if mark.episode not in episodes:
            raise unknown_name("episode", mark.episode, episodes)
        if mark.point not in sites + bodies:
            raise unknown_name("site or body", mark.point, sites + bodies)
        episode = episodes[mark.episode]
        place = positions_at(episode, episode.position, np.array([mark.time]))[0]
        for joint, value in zip(episode.joints, place, strict=True):
            data.qpos[model.joint(joint).qposadr[0]] = value
        Followers(model, episode.joints).place(data.qpos)
        mujoco.mj_kinematics(model, data)
        points.append((data.site if mark.point in sites else data.body)(mark.point).xpos.copy())
    return np.array(points), np.array([[m.u, m.v] for m in marks])


def fit_to_silhouettes(
    robot: RobotModel, episodes: Sequence[Episode], name: str, guess: CameraGuess, frames: int, evaluations: int, seed: int
) -> tuple[Camera, dict[str, Any]]:
    """Pinhole pose and focal length under which the robot covers what moved in the images, by CMA-ES from several sides.

    What moved is the difference from a median over all frames; the loss is one minus the soft overlap of what moved with the part
    of the rendered robot that moved, both blurred at first so that silhouettes attract each other from afar.

    Args:
        frames: images that are compared.
        evaluations: renderings of all frames, over all starts.

    Returns:
        The camera, and the silhouettes' overlap (IoU) that it reaches.

    Raises:
        EdreamError: nothing moves in the images, or this machine cannot render.
    """
    picked = _pictures(episodes, name, frames)
    video = episodes[0].videos[name]
    moved, stances = picked
    h, w = moved.shape[1:]
    if moved.mean() < 0.002:
        raise EdreamError(f"Nothing moves in the images of camera {name!r}; its pose cannot be found from silhouettes.")
    problem = _Silhouettes(robot, moved, stances, guess, h, w)
    starts = problem.starts()
    rough = sorted(starts, key=lambda x: problem.loss(x, 6.0))[:3]
    first = [_descended(problem, start, 5.0, 0.25, int(0.13 * evaluations), seed + i) for i, start in enumerate(rough)]
    best = min(first, key=lambda x: problem.loss(x, 2.0))
    for blur, width, part in ((2.0, 0.1, 0.36), (0.8, 0.03, 0.25)):
        best = _descended(problem, best, blur, width, int(part * evaluations), seed + 7)
    camera = problem.camera(best).resized(video.height, video.width)
    overlap = problem.overlap(best)
    problem.eye.close()
    focal = camera.intrinsics[1, 1]
    camera = Camera(
        video.height, video.width, np.array([[focal, 0, video.width / 2], [0, focal, video.height / 2], [0, 0, 1.0]]), camera.pose
    )
    return camera, {"silhouette_iou": overlap, "frames": len(moved)}


def _descended(
    problem: "_Silhouettes", start: np.ndarray, blur: float, width: float, evaluations: int, seed: int
) -> Float[np.ndarray, "8"]:
    """CMA-ES from a start, at one blur; never worse than the start."""
    import cma

    options = {"seed": seed % 100000 + 1, "verbose": -9, "maxfevals": max(20, evaluations), "popsize": 10}
    found = cma.fmin2(lambda x: problem.loss(x, blur), start, width, options)
    x = np.asarray(found[1].result.xbest)
    return x if problem.loss(x, blur) < problem.loss(start, blur) else start


def _pictures(episodes: Sequence[Episode], name: str, frames: int) -> tuple[Bool[np.ndarray, "F H W"], list[dict[str, float]]]:
    """What moved in images spread over the episodes, and the robot's measured joints in each."""
    video = episodes[0].videos[name]
    scale = min(1.0, SIZE / max(video.height, video.width))
    h, w = max(8, round(video.height * scale)), max(8, round(video.width * scale))
    images, stances = [], []
    some = [episodes[i] for i in np.unique(np.linspace(0, len(episodes) - 1, min(len(episodes), 12)).astype(int))]
    each = max(2, -(-frames * 2 // len(some)))
    for episode in some:
        own = episode.videos[name]
        rows = np.unique(np.linspace(0, len(own.times) - 1, each).astype(int))
        images += list(frames_at(own, rows, h, w))
        places = positions_at(episode, episode.position, own.times[rows])
        stances += [dict(zip(episode.joints, place, strict=True)) for place in places]
    stack = np.stack(images).astype(np.float32)
    still = np.median(stack, axis=0)
    # the light wanders: each image is brought to the median's brightness before it is compared
    gain = np.median(still.sum(-1) / np.maximum(stack.sum(-1), 1.0), axis=(1, 2))
    apart = np.abs(stack * gain[:, None, None, None] - still).max(axis=3)
    keep = np.unique(np.linspace(0, len(stack) - 1, frames).astype(int))
    moved = apart > max(18.0, 4.0 * float(np.median(apart)))
    return moved[keep], [stances[i] for i in keep]


class _Silhouettes:
    """The loss over (azimuth, elevation, log distance, look-at point x y z, roll, log focal length), each in its own unit."""

    def __init__(
        self, robot: RobotModel, moved: np.ndarray, stances: list[dict[str, float]], guess: CameraGuess, h: int, w: int
    ) -> None:
        self.moved, self.stances, self.guess, self.h, self.w = moved.astype(np.float32), stances, guess, h, w
        self.size = _extent(robot, stances)
        pose = looking_at(np.array([1.0, 0.0, 1.0]), np.zeros(3))
        self.eye = SimulationCamera(
            lightened(robot, TRIANGLES), Camera(h, w, np.array([[h, 0, w / 2], [0, h, h / 2], [0, 0, 1.0]]), pose), supersampling=1
        )
        self._targets: dict[float, np.ndarray] = {}

    def starts(self) -> list[np.ndarray]:
        guess = self.guess
        sides = np.arange(0, 360, 30.0) if guess.azimuth is None else guess.azimuth + np.array([-20.0, 0.0, 20.0])
        distance = guess.distance or 2.6 * self.size
        heights = (guess.elevation,) if guess.azimuth is not None else (15.0, 40.0)
        focal = 0.5 / np.tan(0.5 * np.radians(guess.fovy))
        middle = [0.0, 0.0, 0.35]
        return [
            np.array([np.radians(a), np.radians(e), np.log(distance / self.size), *middle, 0.0, np.log(focal)])
            for a in sides
            for e in heights
        ]

    def camera(self, x: np.ndarray) -> Camera:
        azimuth, elevation, distance = x[0], np.clip(x[1], -1.3, 1.45), self.size * np.exp(np.clip(x[2], -1.5, 2.5))
        target = self.size * x[3:6]
        way = np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
        focal = self.h * np.exp(np.clip(x[7], -1.5, 2.0))
        matrix = np.array([[focal, 0, self.w / 2], [0, focal, self.h / 2], [0, 0, 1.0]])
        return Camera(self.h, self.w, matrix, looking_at(target + distance * way, target, roll=float(x[6])))

    def masks(self, x: np.ndarray) -> np.ndarray:
        camera = self.camera(x)
        self.eye.move_to(camera.pose, float(camera.intrinsics[1, 1]))
        return np.stack([self.eye.mask(stance) for stance in self.stances]).astype(np.float32) / 255.0

    def moving(self, masks: np.ndarray) -> np.ndarray:
        """Where the rendered robot differs from a median over the frames: it is there and seldom is, or the reverse."""
        return np.abs(masks - np.median(masks, axis=0))

    def loss(self, x: np.ndarray, blur: float) -> float:
        if blur not in self._targets:
            self._targets[blur] = np.stack([cv2.GaussianBlur(m, (0, 0), blur) for m in self.moved])
        seen = np.stack([cv2.GaussianBlur(m, (0, 0), blur) for m in self.moving(self.masks(x))])
        target = self._targets[blur]
        common = np.minimum(seen, target).sum()
        # other things move too (objects, shadows): what is not robot costs less than robot that is not seen
        return 1.0 - float(common / (0.7 * seen.sum() + 0.3 * target.sum() + 1e-6)) + 0.01 * float(x[6] ** 2)

    def overlap(self, x: np.ndarray) -> float:
        seen, target = self.moving(self.masks(x)) > 0.5, self.moved > 0.5
        return float((seen & target).sum() / max((seen | target).sum(), 1))


def _extent(robot: RobotModel, stances: Sequence[dict[str, float]]) -> float:
    model, data, far = robot.model, mujoco.MjData(robot.model), 0.05
    for stance in stances:
        for joint, value in stance.items():
            data.qpos[model.joint(joint).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        far = max(far, float(np.linalg.norm(data.xpos[1:], axis=1).max()))
    return far
