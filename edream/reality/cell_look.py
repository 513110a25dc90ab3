"""How the workcell looks in reality: its own textures, a lamp with shadows, cameras a little elsewhere, blur and noise."""

import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import mujoco
import numpy as np
from jaxtyping import UInt8
from mujoco.rendering.classic import gl_context

from edream.core.bench import Bench
from edream.core.camera import Camera, pinhole
from edream.core.task import Layout
from edream.reality.look import materials, sensed

CAMERA = "reality_"
A4 = (0.297, 0.21)  # [m]
SCALE = 2  # images are rendered so many times larger, then averaged


@dataclass(frozen=True)
class CellLook:
    """What the cameras are like.

    Attributes:
        cameras: which of the bench's views.
        height, width: size of the images [pixel].
        noise: standard deviation of the sensor's noise at mid grey [levels of 255].
        drift: how far the light and the automatic exposure wander, as a share.
        blur: standard deviation of the lens' blur, as a share of the image's height.
        shift: how far a camera may stand from where it was meant to [m].
        paper: how a sheet of A4 paper lies on the table, seen and not felt: a change of scene that no demonstration has shown.
    """

    cameras: tuple[str, ...] = ("cam_high",)
    height: int = 64
    width: int = 64
    noise: float = 2.0
    drift: float = 0.06
    blur: float = 0.006
    shift: float = 0.012
    paper: Literal["none", "horizontal", "vertical"] = "none"

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> "CellLook":
        """The cameras that a sealed truth tells of; the usual ones where it tells of none."""
        return cls(**{**told, "cameras": tuple(told["cameras"])}) if told else cls()


def placed_cameras(bench: Bench, look: CellLook, seed: int) -> dict[str, Camera]:
    """Where the cameras truly stand; those on a hand in its site's frame.

    Raises:
        EdreamError: the bench has no such camera.
    """
    out = {}
    for name in sorted(bench.views):
        rng = np.random.default_rng(np.random.SeedSequence((seed, sum(name.encode()))))
        view, pose = bench.views[name], np.array(bench.views[name].pose)
        turn = np.zeros(9)
        axis, angle = rng.standard_normal(3), look.shift * rng.uniform(0.3, 1.0)
        quat = np.zeros(4)
        mujoco.mju_axisAngle2Quat(quat, axis / np.linalg.norm(axis), angle)
        mujoco.mju_quat2Mat(turn, quat)
        scale = 0.2 if view.on else 1.0
        pose[:3, :3] = turn.reshape(3, 3) @ pose[:3, :3]
        pose[:3, 3] += scale * look.shift * rng.uniform(-1.0, 1.0, 3)
        out[name] = pinhole(look.height, look.width, view.fovy * float(rng.uniform(0.98, 1.02)), pose)
    return {name: out[name] for name in look.cameras if bench.view(name)}


def dress(spec: mujoco.MjSpec, bench: Bench, layout: Layout | None, look: CellLook, seed: int) -> None:
    """Paint the robot, set the room around the bench, hang the lamp and put up the cameras."""
    rng = np.random.default_rng(np.random.SeedSequence((seed, 0x100C)))
    for name in [one.name for one in spec.cameras]:
        spec.delete(spec.camera(name))
    materials(spec, rng)
    for geom in spec.geoms:
        if not geom.material:
            light = float(np.mean(geom.rgba[:3]))
            geom.material = "reality_pale" if light > 0.6 else "reality_dark" if light < 0.35 else "reality_mark"
            geom.rgba = [1.0, 1.0, 1.0, 1.0]
    for site in spec.sites:
        site.rgba = [0.0, 0.0, 0.0, 0.0]
    for thing in layout.things if layout else ():
        _paint(spec, thing.name, np.array(thing.proxy.colour), rng)
    (tx, ty, tz), (cx, cy, cz) = bench.table
    world, plain = spec.worldbody, {"contype": 0, "conaffinity": 0, "mass": 0.0}
    box, plane = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_PLANE
    top = world.add_geom(type=box, size=[tx, ty, tz], pos=[cx, cy, cz], material="reality_wood")
    top.name, top.contype, top.conaffinity = "table", 1, 0
    world.add_geom(type=plane, size=[4, 4, 1], pos=[cx - tx - 0.5, 0, 0], zaxis=[1, 0, 0.02], material="reality_wall", **plain)
    world.add_geom(type=plane, size=[4, 4, 1], pos=[0, cy + ty + 0.5, 0], zaxis=[0, -1, 0.02], material="reality_wall", **plain)
    world.add_geom(type=plane, size=[4, 4, 1], pos=[0, 0, cz - 0.6], material="reality_wall", **plain)
    at = [cx - 0.6 * tx, cy + 0.75 * ty, cz + tz + 0.06]
    world.add_geom(type=box, size=[0.09, 0.07, 0.06], pos=at, material="reality_mark", **plain)
    if look.paper != "none":
        sheet = np.array(A4 if look.paper == "vertical" else A4[::-1])
        at = [cx + 0.02, cy + 0.02, cz + tz + 0.0006]
        page = world.add_geom(type=box, size=[*sheet / 2, 0.0005], pos=at, rgba=[0.95, 0.95, 0.93, 1.0], **plain)
        page.material = "paper"
        spec.add_material(name="paper", specular=0.1, rgba=[0.95, 0.95, 0.93, 1.0])
    lamp = {"castshadow": True, "diffuse": [0.7, 0.67, 0.62], "specular": [0.2] * 3, "ambient": [0.05] * 3}
    slant = [-0.35 + 0.2 * rng.uniform(-1, 1), 0.5 + 0.2 * rng.uniform(-1, 1), -1.0]
    world.add_light(pos=[cx + 0.8, -1.0, cz + 1.8], dir=slant, type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, **lamp)
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.3, 0.31, 0.34], [0.12] * 3
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = 512, 0
    spec.visual.quality.numslices, spec.visual.quality.numstacks = 12, 6
    spec.visual.global_.offwidth, spec.visual.global_.offheight = look.width * SCALE, look.height * SCALE
    spec.visual.map.znear = 0.005
    for name, camera in placed_cameras(bench, look, seed).items():
        _put_up(spec, name, camera, bench.view(name).on)


def _paint(spec: mujoco.MjSpec, name: str, colour: np.ndarray, rng: np.random.Generator) -> None:
    texture = spec.add_texture(name=f"thing_{name}", type=mujoco.mjtTexture.mjTEXTURE_CUBE, width=64, height=64)
    texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    texture.rgb1 = np.clip(colour * rng.uniform(0.85, 1.05, 3), 0, 1)
    texture.rgb2 = np.clip(colour * rng.uniform(0.65, 0.85, 3), 0, 1)
    material = spec.add_material(name=f"thing_{name}", specular=0.2, shininess=0.3)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = f"thing_{name}"


def _put_up(spec: mujoco.MjSpec, name: str, camera: Camera, on: str | None) -> None:
    pose = np.array(camera.pose)
    carrier = next(site for site in spec.sites if site.name == on) if on else None
    if carrier is not None:
        pose[:3, 3] += carrier.pos
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, (pose[:3, :3] * [1.0, -1.0, -1.0]).ravel())
    fovy = 2.0 * np.arctan(0.5 * camera.height / camera.intrinsics[1, 1])
    body = carrier.parent if carrier is not None else spec.worldbody
    body.add_camera(name=CAMERA + name, pos=pose[:3, 3], quat=quat, fovy=float(np.degrees(fovy)))


class Lens:
    """The cameras, kept from trial to trial: models of one bench and task share their textures."""

    def __init__(self, model: mujoco.MjModel, look: CellLook) -> None:
        self.look, width, height = look, look.width * SCALE, look.height * SCALE
        self._gl = gl_context.GLContext(width, height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._view, self._option, self._from = mujoco.MjvScene(model, maxgeom=400), mujoco.MjvOption(), mujoco.MjvCamera()
        self._view.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 1
        self._from.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._rectangle, self._image = mujoco.MjrRect(0, 0, width, height), np.zeros((height, width, 3), np.uint8)
        self._freeing = weakref.finalize(self, _free, self._gl, self._context)
        self._freeing.atexit = False  # at the interpreter's end the display may be gone by then
        self.begin(0)

    def begin(self, seed: int) -> None:
        """Another trial, in another light."""
        self.seed, rng = seed, np.random.default_rng(seed)
        self.phase, self.level = rng.uniform(0.0, 2.0 * np.pi, 2), 1.0 + self.look.drift * rng.uniform(-1.0, 1.0)

    def see(
        self, model: mujoco.MjModel, data: mujoco.MjData, time: float, clean: bool = False
    ) -> dict[str, UInt8[np.ndarray, "H W 3"]]:
        """The images as the cameras give them; `clean` ones without drift and noise. What was looked at before changes nothing."""
        look, drift, rng = self.look, self.look.drift, np.random.default_rng((self.seed, round(1e4 * time)))
        light = self.level * (1.0 + 0.5 * drift * np.sin(2.0 * np.pi * time / 7.0 + self.phase[0]))
        warmth = 1.0 + 0.25 * drift * np.array([1.0, 0.0, -1.0]) * np.sin(2.0 * np.pi * time / 11.0 + self.phase[1])
        out = {}
        self._gl.make_current()
        for name in look.cameras:
            self._from.fixedcamid = int(model.camera(CAMERA + name).id)
            mujoco.mjv_updateScene(model, data, self._option, None, self._from, mujoco.mjtCatBit.mjCAT_ALL, self._view)
            mujoco.mjr_render(self._rectangle, self._view, self._context)
            mujoco.mjr_readPixels(self._image, None, self._rectangle, self._context)
            image = np.ascontiguousarray(self._image[::-1])
            if look.blur > 0.0:
                image = cv2.GaussianBlur(image, (0, 0), look.blur * image.shape[0])
            small = image.reshape(look.height, SCALE, look.width, SCALE, 3).mean(axis=(1, 3)) / 255.0
            out[name] = sensed(small, np.ones(3) if clean else light * warmth, 0.0 if clean else look.noise, rng)
        return out

    def close(self) -> None:
        """Free the graphics context; one that is forgotten unclosed is freed as well."""
        self._freeing()


def _free(gl: Any, context: mujoco.MjrContext) -> None:
    """What is freed goes by its number in the context that is current, which may be another lens's."""
    gl.make_current()
    context.free()
    gl.free()
