"""The cameras of a workcell: one graphics context for all of them and for every trial."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import UInt8
from mujoco.rendering.classic import gl_context

from edream.core.bench import Bench
from edream.core.camera import Camera
from edream.core.policy import Conditions
from edream.sim.camera import graphics

EYE = "task_eye_"
SHOWN = (0, 1, 2)  # groups of geoms of the robot
PROXIES, PARTS, DECOR = 3, 4, 5


@dataclass(frozen=True, eq=False)
class Images:
    """How a workcell is seen.

    Attributes:
        cameras: which of the bench's views.
        height, width: size of the images [pixel].
        placed: cameras as calibrated, by name, in place of the bench's views.
        raw: whether observations hold the raw rendering; else they hold no images, and `conditions` says what is to be seen.
        supersampling: images are rendered so many times larger and averaged.
    """

    cameras: tuple[str, ...] = ("cam_high",)
    height: int = 64
    width: int = 64
    placed: Mapping[str, Camera] | None = None
    raw: bool = True
    supersampling: int = 1


def furnish_views(spec: mujoco.MjSpec, bench: Bench, images: Images) -> None:
    """Put the cameras into a spec, with the light of `edream.sim.camera`, and take away those it had.

    Raises:
        EdreamError: the bench has no such camera.
    """
    for name in [one.name for one in spec.cameras]:
        spec.delete(spec.camera(name))
    for name in images.cameras:
        view = bench.view(name)
        placed = (images.placed or {}).get(name)
        carrier = next(site for site in spec.sites if site.name == view.on) if view.on else None
        pose, camera = np.array(view.pose), (carrier.parent if carrier else spec.worldbody).add_camera(name=EYE + name)
        if carrier is not None:
            frame = np.eye(4)
            frame[:3, 3] = carrier.pos
            pose = frame @ pose
        if placed is not None:
            size = placed.resized(images.height, images.width)
            pose, matrix = (pose if placed.moves else np.array(placed.pose)), size.intrinsics
            camera.resolution = [images.width, images.height]
            camera.focal_pixel = [matrix[0, 0], matrix[1, 1]]
            camera.principal_pixel = [images.width / 2 - matrix[0, 2], images.height / 2 - matrix[1, 2]]
            camera.sensor_size = [images.width * 1e-5, images.height * 1e-5]
        else:
            camera.fovy = float(np.degrees(view.fovy))
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, (pose[:3, :3] * [1.0, -1.0, -1.0]).ravel())
        camera.pos, camera.quat = pose[:3, 3], quat
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = images.width * images.supersampling, images.height * images.supersampling
    visual.quality.offsamples, visual.map.znear = 0, 0.005
    visual.quality.numslices, visual.quality.numstacks = 16, 8
    visual.headlight.ambient, visual.headlight.diffuse = [0.35] * 3, [0.55] * 3


class Eyes:
    """Renders the models of one robot and task, which share their meshes and textures.

    Raises:
        EdreamError: this machine cannot render.
    """

    def __init__(self, model: mujoco.MjModel, images: Images) -> None:
        self.images, k = images, images.supersampling
        self._rectangle = mujoco.MjrRect(0, 0, images.width * k, images.height * k)
        with graphics():
            self._gl = gl_context.GLContext(images.width * k, images.height * k)
            self._gl.make_current()
            self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._view = mujoco.MjvScene(model, maxgeom=400)
        self._view.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        self._view.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        self._option, self._from = mujoco.MjvOption(), mujoco.MjvCamera()
        self._from.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._image = np.zeros((images.height * k, images.width * k, 3), np.uint8)
        self._depth = np.zeros((images.height * k, images.width * k), np.float32)

    def close(self) -> None:
        """Free the graphics context."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()

    def colours(self, model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, UInt8[np.ndarray, "H W 3"]]:
        """Raw images: robot, table and things."""
        self._gl.make_current()
        out = {}
        for name in self.images.cameras:
            self._show(model, data, name, (*SHOWN, PARTS, DECOR))
            out[name] = self._small(self._draw())
        return out

    def conditions(self, model: mujoco.MjModel, data: mujoco.MjData) -> Mapping[str, Conditions]:
        """Robot and plain things before black, and which pixel shows what."""
        self._gl.make_current()
        is_thing = (model.geom_group >= PROXIES).astype(bool)
        out = {}
        for name in self.images.cameras:
            self._show(model, data, name, (*SHOWN, PROXIES))
            colour = self._small(self._draw())
            self._view.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = 1
            self._view.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 1
            parts = self._draw().astype(np.int32)
            self._view.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = 0
            self._view.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = 0
            number = parts[..., 0] + 256 * parts[..., 1] + 65536 * parts[..., 2] - 1
            kinds = np.zeros(self._view.ngeom + 1, dtype=np.uint8)  # 0 nothing, 1 robot, 2 thing; the last entry is the background
            for i in range(self._view.ngeom):
                geom = self._view.geoms[i]
                if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM and geom.segid >= 0:
                    kinds[geom.segid] = 2 if is_thing[geom.objid] else 1
            kind = kinds[number]
            out[name] = Conditions(colour, self._small(255 * (kind == 1)), self._small(255 * (kind == 2)))
        return out

    def cutouts(
        self, model: mujoco.MjModel, data: mujoco.MjData
    ) -> dict[str, tuple[UInt8[np.ndarray, "H W 3"], UInt8[np.ndarray, "H W"]]]:
        """Robot and plain things before black, and the share of each pixel that they cover, as 0..255; at half the price."""
        self._gl.make_current()
        out = {}
        for name in self.images.cameras:
            self._show(model, data, name, (*SHOWN, PROXIES))
            mujoco.mjr_render(self._rectangle, self._view, self._context)
            mujoco.mjr_readPixels(self._image, self._depth, self._rectangle, self._context)
            covered = self._depth[::-1] < 1.0  # nothing is as far as the far plane
            out[name] = self._small(self._image[::-1]), self._small(255 * covered)
        return out

    def _show(self, model: mujoco.MjModel, data: mujoco.MjData, name: str, groups: tuple[int, ...]) -> None:
        self._option.geomgroup[:] = 0
        self._option.geomgroup[list(groups)] = 1
        self._from.fixedcamid = int(model.camera(EYE + name).id)
        mujoco.mjv_updateScene(model, data, self._option, None, self._from, mujoco.mjtCatBit.mjCAT_ALL, self._view)

    def _draw(self) -> np.ndarray:
        mujoco.mjr_render(self._rectangle, self._view, self._context)
        mujoco.mjr_readPixels(self._image, None, self._rectangle, self._context)
        return self._image[::-1]

    def _small(self, image: np.ndarray) -> np.ndarray:
        k = self.images.supersampling
        if k == 1:
            return image.astype(np.uint8)
        h, w = image.shape[0] // k, image.shape[1] // k
        total = np.asarray(image, np.uint32).reshape(h, k, w, k, *image.shape[2:]).sum(axis=(1, 3))
        return ((total + k * k // 2) // (k * k)).astype(np.uint8)
