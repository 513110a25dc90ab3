"""A simulated robot, and simulated objects, seen from a camera: colours and masks without a window."""

import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec

import mujoco
import numpy as np
from jaxtyping import Float, UInt8
from mujoco.rendering.classic import gl_context

from edream.core.camera import Camera
from edream.core.errors import EdreamError, unknown_name
from edream.core.scene import SceneObject
from edream.sim.followers import Followers
from edream.sim.robot import RobotModel

EYE = "edream_camera"
OBJECT = "edream_object_"
SHAPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
}
NO_GRAPHICS = (
    "This machine cannot render without a window: neither EGL nor OSMesa works. On Debian or Ubuntu install libegl1, "
    "libgl1-mesa-dri and libopengl0, or libosmesa6 alone; 'edream doctor' says what is found."
)


@dataclass(frozen=True, eq=False)
class Seen:
    """One image of the simulation.

    Attributes:
        colour: RGB, black where there is nothing, (H, W, 3).
        robot: share of each pixel that the robot covers, as 0..255, (H, W).
        object: the same of the simulated objects, where the robot does not hide them, (H, W).
    """

    colour: UInt8[np.ndarray, "H W 3"]
    robot: UInt8[np.ndarray, "H W"]
    object: UInt8[np.ndarray, "H W"]


def prepare_graphics() -> None:
    """Where there is no display and nothing is asked for by MUJOCO_GL, render with EGL, else with OSMesa.

    MuJoCo chooses once, when it is imported, and then for a window; so its choice is replaced here.

    Raises:
        EdreamError: neither is there.
    """
    _compiler_first()
    if os.environ.get("MUJOCO_GL") or os.environ.get("DISPLAY") or platform.system() != "Linux":
        return
    said = []
    for kind in ("egl", "osmesa"):
        try:
            gl_context.GLContext = import_module(f"mujoco.{kind}").GLContext
            return
        except (ImportError, AttributeError, RuntimeError) as error:
            said.append(f"{kind}: {_one_line(error)}")
    raise EdreamError(f"{NO_GRAPHICS} ({'; '.join(said)})")


def _compiler_first() -> None:
    """Load torch's compiler before any graphics, where it is installed.

    Both it and Mesa's software renderer bring an LLVM of their own. With Mesa's loaded first, the other one ends the process when
    torch asks for it (a segmentation fault: torch 2.15, triton 3.9, Mesa 22.3); the other way round both work.
    """
    if platform.system() == "Linux" and find_spec("triton") is not None:
        with suppress(ImportError, OSError):  # torch says so itself where it needs it
            import_module("triton._C.libtriton")


class SimulationCamera:
    """Renders one robot from one camera; keep it, for making it is what costs.

    What is fixed to the world (floor, table) is left out: the robot stands alone before black.

    Args:
        robot: the robot.
        camera: the camera; images have its size.
        objects: simulated objects that may stand in the scene.
        supersampling: images are rendered so many times larger and averaged, which is cheaper than MuJoCo's own multisampling.
        hidden: bodies that are left out.

    Raises:
        EdreamError: this machine cannot render, or a body does not exist.
    """

    def __init__(
        self,
        robot: RobotModel,
        camera: Camera,
        objects: Sequence[SceneObject] = (),
        supersampling: int = 2,
        hidden: Sequence[str] = (),
    ) -> None:
        self.camera, self.factor = camera, supersampling
        height, width = camera.height * supersampling, camera.width * supersampling
        self.model = _scene(robot, camera.resized(height, width), objects, hidden)
        self.data = mujoco.MjData(self.model)
        self._qpos = {joint: int(self.model.jnt_qposadr[self.model.joint(joint).id]) for joint in robot.joints}
        self._followers = Followers(self.model, robot.joints)
        self._mocap = {one.name: int(self.model.body(OBJECT + one.name).mocapid[0]) for one in objects}
        self._geoms = {
            OBJECT: [g for g in range(self.model.ngeom) if self.model.body(self.model.geom_bodyid[g]).name.startswith(OBJECT)]
        }
        with graphics():
            self._renderer = mujoco.Renderer(self.model, height, width)

    def close(self) -> None:
        """Free the graphics context."""
        self._renderer.close()

    def see(self, joints: Mapping[str, float], objects: Mapping[str, Float[np.ndarray, "7"]] | None = None, frame: int = 0) -> Seen:
        """The robot at joint positions [rad or m], with the objects at poses (x y z [m], quaternion w x y z); others are away."""
        self._place(joints, objects or {}, frame)
        colour, parts = self._images()
        number = np.where(parts[..., 1] == int(mujoco.mjtObj.mjOBJ_GEOM), parts[..., 0], -1)
        is_object = np.isin(number, self._geoms[OBJECT])
        return Seen(self._small(colour), self._small(255 * ((number >= 0) & ~is_object)), self._small(255 * is_object))

    def mask(self, joints: Mapping[str, float], frame: int = 0) -> UInt8[np.ndarray, "H W"]:
        """Share of each pixel that the robot covers, as 0..255, (H, W); half the price of `see`."""
        self._place(joints, {}, frame)
        return self._small(255 * (self._parts()[..., 0] >= 0))

    def move_to(self, pose: Float[np.ndarray, "4 4"], focal: float | None = None) -> None:
        """Put the camera elsewhere, with another focal length [pixel] if given."""
        intrinsics = self.camera.intrinsics.copy()
        if focal is not None:
            intrinsics[[0, 1], [0, 1]] = focal
            self.model.cam_intrinsic[0, :2] = focal * self.factor * self.model.cam_sensorsize[0] / self.model.cam_resolution[0]
        self.camera = Camera(self.camera.height, self.camera.width, intrinsics, pose)

    def _place(self, joints: Mapping[str, float], objects: Mapping[str, np.ndarray], frame: int) -> None:
        for joint, value in joints.items():
            if joint not in self._qpos:
                raise unknown_name("joint", joint, self._qpos)
            self.data.qpos[self._qpos[joint]] = value
        self._followers.place(self.data.qpos)
        for name, mocap in self._mocap.items():
            pose = objects.get(name)
            self.data.mocap_pos[mocap] = [0.0, 0.0, -1e3] if pose is None else pose[:3]
            self.data.mocap_quat[mocap] = [1.0, 0.0, 0.0, 0.0] if pose is None else pose[3:]
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        pose = self.camera.at(frame)
        self.data.cam_xpos[0] = pose[:3, 3]
        self.data.cam_xmat[0] = (pose[:3, :3] * [1.0, -1.0, -1.0]).ravel()

    def _images(self) -> tuple[np.ndarray, np.ndarray]:
        self._renderer.update_scene(self.data, EYE)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        return self._renderer.render(), self._parts(updated=True)

    def _parts(self, updated: bool = False) -> np.ndarray:
        self._renderer.enable_segmentation_rendering()
        try:
            if not updated:
                self._renderer.update_scene(self.data, EYE)
            return self._renderer.render()
        finally:
            self._renderer.disable_segmentation_rendering()

    def _small(self, image: np.ndarray) -> np.ndarray:
        k = self.factor
        h, w = image.shape[0] // k, image.shape[1] // k
        total = np.asarray(image, np.uint32).reshape(h, k, w, k, *image.shape[2:]).sum(axis=(1, 3))
        return ((total + k * k // 2) // (k * k)).astype(np.uint8)


@contextmanager
def graphics() -> Iterator[None]:
    """Turn MuJoCo's complaints about missing graphics into one sentence.

    Raises:
        EdreamError: this machine cannot render.
    """
    prepare_graphics()
    try:
        yield
    except (RuntimeError, ImportError, AttributeError, mujoco.FatalError) as error:
        raise EdreamError(f"{NO_GRAPHICS} (MuJoCo: {_one_line(error)})") from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def _scene(robot: RobotModel, camera: Camera, objects: Sequence[SceneObject], hidden: Sequence[str]) -> mujoco.MjModel:
    spec = robot.spec()
    bodies = [body.name for body in spec.bodies]
    for name in hidden:
        if name not in bodies:
            raise unknown_name("body", name, bodies)
    for geom in spec.geoms:
        if geom.parent.name == "world" or geom.parent.name in hidden:
            geom.rgba, geom.material = [0.0, 0.0, 0.0, 0.0], ""
    for site in spec.sites:
        site.rgba = [0.0, 0.0, 0.0, 0.0]
    for name in [one.name for one in spec.cameras]:
        spec.delete(spec.camera(name))
    for one in objects:
        body = spec.worldbody.add_body(name=OBJECT + one.name, mocap=True)
        body.add_geom(type=SHAPES[one.shape], size=one.size3, rgba=[*one.colour, 1.0], contype=0, conaffinity=0, mass=0.0)
    fx, fy = camera.intrinsics[0, 0], camera.intrinsics[1, 1]
    cx, cy = camera.intrinsics[0, 2], camera.intrinsics[1, 2]
    spec.worldbody.add_camera(
        name=EYE,
        resolution=[camera.width, camera.height],
        focal_pixel=[fx, fy],
        principal_pixel=[camera.width / 2 - cx, camera.height / 2 - cy],  # measured: MuJoCo counts both against the image axes
        sensor_size=[camera.width * 1e-5, camera.height * 1e-5],
    )
    spec.visual.global_.offwidth, spec.visual.global_.offheight = camera.width, camera.height
    spec.visual.quality.offsamples = 0
    spec.visual.map.znear = 0.005
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.35] * 3, [0.55] * 3
    model = spec.compile()
    if model.cam_bodyid[0] != 0 or model.ncam != 1:
        raise EdreamError(f"Robot {robot.name!r}: its model brings cameras that cannot be set aside; remove them from the MJCF.")
    return model
