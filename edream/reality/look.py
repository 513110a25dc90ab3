"""How the make-believe robot looks to a camera: its own colours, textures, lights that drift, shadows, a thing that moves, noise.

Nothing of this is shared with what renders the simulator (`edream.sim.camera`).
"""

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

from edream.core.camera import Camera, looking_at, pinhole
from edream.core.scene import ObjectTrack, SceneObject
from edream.sim.robot import RobotModel

THING = SceneObject("block", "box", (0.065, 0.046, 0.054), (0.5, 0.6, 0.8))
SCALE = 2  # images are rendered so many times larger, then averaged


@dataclass(frozen=True)
class Look:
    """What the camera is like and how restless the scene is.

    Attributes:
        height, width: size of the images [pixel].
        noise: standard deviation of the sensor's noise at mid grey, in grey levels of 255.
        drift: how far the light wanders, as a share of its brightness.
        things: whether an object moves about.
    """

    height: int = 96
    width: int = 96
    noise: float = 2.5
    drift: float = 0.08
    things: bool = True


@dataclass(frozen=True, eq=False)
class Session:
    """What was in front of the camera during one recording.

    Attributes:
        times: of the images [s], (T,).
        joints: positions of all joints as they truly were [rad or m], (T, nq).
        thing: where the object was.
        seed: of light and noise.
    """

    times: Float[np.ndarray, "T"]
    joints: Float[np.ndarray, "T J"]
    thing: ObjectTrack | None
    seed: int


class Studio:
    """The make-believe robot on its table, seen by one camera."""

    def __init__(self, robot: RobotModel, look: Look, seed: int) -> None:
        self.look, self.reach = look, _reach(robot.model)
        self.table = -0.3 * self.reach
        rng = np.random.default_rng(seed)
        self.camera = _placed(look, self.reach, rng)
        self.model = _stage(robot, self.camera, self.reach, self.table, rng)
        self.scale = self.reach / 0.75

    def thing(self) -> SceneObject:
        """The moving object as its owner would model it: right in shape and size, roughly in colour."""
        return SceneObject(THING.name, THING.shape, tuple(self.scale * s for s in THING.size), THING.colour)  # type: ignore[arg-type]

    def wander(self, times: Float[np.ndarray, "T"], rng: np.random.Generator) -> ObjectTrack:
        """A path of the object over the table: slow slides and turns, with rests, in front of the camera."""
        knots = np.arange(times[0], times[-1] + 2.0, 1.5)
        low, high = np.array([0.1, -0.55]) * self.reach, np.array([0.6, 0.35]) * self.reach
        places = rng.uniform(low, high, (len(knots), 2))
        rest = rng.random(len(knots)) < 0.35
        angle = np.cumsum(rng.normal(0.0, 0.6, len(knots)))
        for k in range(1, len(knots)):
            step = places[k] - places[k - 1]
            places[k] = places[k - 1] + step * min(1.0, 0.3 * self.reach / max(np.linalg.norm(step), 1e-9))
            if rest[k]:
                places[k], angle[k] = places[k - 1], angle[k - 1]
        part = np.clip((times[:, None] - knots[None, :-1]) / np.diff(knots), 0.0, 1.0)
        eased = part * part * (3.0 - 2.0 * part)
        path = np.concatenate([places, angle[:, None]], axis=1)
        at = path[0] + eased @ np.diff(path, axis=0)
        height = np.full(len(times), self.table + self.thing().size[2])
        turn = np.stack([np.cos(at[:, 2] / 2), 0 * height, 0 * height, np.sin(at[:, 2] / 2)], axis=1)
        return ObjectTrack(times, np.concatenate([at[:, :2], height[:, None], turn], axis=1))

    def frames(self, session: Session) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
        """The images as the camera gives them."""
        rng = np.random.default_rng(session.seed)
        phase, level = rng.uniform(0.0, 2.0 * np.pi, 3), 1.0 + self.look.drift * rng.uniform(-1.0, 1.0)
        with _Eye(self.model, self.camera) as eye:
            for row, time in enumerate(session.times):
                light = level * (1.0 + 0.5 * self.look.drift * np.sin(2.0 * np.pi * time / 7.0 + phase[0]))
                warmth = 1.0 + 0.25 * self.look.drift * np.array([1.0, 0.0, -1.0]) * np.sin(2.0 * np.pi * time / 11.0 + phase[1])
                thing = None if session.thing is None else session.thing.at(float(time))
                yield sensed(eye.look(session.joints[row], thing), light * warmth, self.look.noise, rng)

    def masks(self, session: Session) -> Iterator[UInt8[np.ndarray, "H W"]]:
        """Where the object is to be seen, 0 or 1: the truth that segmenters are judged by."""
        with _Eye(self.model, self.camera) as eye:
            for row, time in enumerate(session.times):
                thing = None if session.thing is None else session.thing.at(float(time))
                yield eye.thing(session.joints[row], thing)

    def plate(self) -> UInt8[np.ndarray, "H W 3"]:
        """The scene without robot and object, as one would photograph it beforehand."""
        bare = _without(self.model)
        with _Eye(bare, self.camera) as eye:
            return sensed(eye.look(np.zeros(self.model.nq), None), np.ones(3), 0.0, np.random.default_rng(0))


class _Eye:
    """A renderer for one camera, freed at the end."""

    def __init__(self, model: mujoco.MjModel, camera: Camera) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.renderer = mujoco.Renderer(model, camera.height * SCALE, camera.width * SCALE)
        self.renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 1

    def __enter__(self) -> "_Eye":
        return self

    def __exit__(self, *_: object) -> None:
        self.renderer.close()

    def _place(self, joints: np.ndarray, thing: np.ndarray | None) -> None:
        self.data.qpos[: len(joints)] = joints
        self.data.mocap_pos[0] = [0.0, 0.0, -100.0] if thing is None else thing[:3]
        self.data.mocap_quat[0] = [1.0, 0.0, 0.0, 0.0] if thing is None else thing[3:]
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)
        self.renderer.update_scene(self.data, "reality_camera")

    def look(self, joints: np.ndarray, thing: np.ndarray | None) -> Float[np.ndarray, "H W 3"]:
        self._place(joints, thing)
        image = self.renderer.render().astype(np.float64) / 255.0
        return image.reshape(image.shape[0] // SCALE, SCALE, image.shape[1] // SCALE, SCALE, 3).mean(axis=(1, 3))

    def thing(self, joints: np.ndarray, thing: np.ndarray | None) -> UInt8[np.ndarray, "H W"]:
        self._place(joints, thing)
        self.renderer.enable_segmentation_rendering()
        parts = self.renderer.render()
        self.renderer.disable_segmentation_rendering()
        geom = int(self.model.geom("reality_thing").id)
        seen = (parts[..., 0] == geom) & (parts[..., 1] == int(mujoco.mjtObj.mjOBJ_GEOM))
        return (seen.reshape(seen.shape[0] // SCALE, SCALE, seen.shape[1] // SCALE, SCALE).mean(axis=(1, 3)) >= 0.5).astype(
            np.uint8
        )


def sensed(image: np.ndarray, light: np.ndarray, noise: float, rng: np.random.Generator) -> UInt8[np.ndarray, "H W 3"]:
    """Lens and sensor: darker corners, the light's brightness, a tone curve, noise that grows with the signal, 8 bits."""
    h, w = image.shape[:2]
    y, x = np.mgrid[0:h, 0:w]
    corner = ((x - w / 2 + 0.5) ** 2 + (y - h / 2 + 0.5) ** 2) / (0.25 * (h * h + w * w))
    toned = np.clip(image * light * (1.0 - 0.22 * corner)[..., None], 0.0, 1.0) ** 0.9 * 0.94 + 0.03
    spread = noise / 255.0 * np.sqrt(0.4 + 1.2 * toned)
    return np.clip(np.round(255.0 * (toned + spread * rng.normal(size=toned.shape))), 0, 255).astype(np.uint8)


def _reach(model: mujoco.MjModel) -> float:
    """How far the robot's parts get from its base [m], over random poses."""
    rng, data, far = np.random.default_rng(0), mujoco.MjData(model), 0.05
    low, high = np.where(model.jnt_limited[:, None], model.jnt_range, [-np.pi, np.pi]).T
    for _ in range(64):
        data.qpos[: model.njnt] = rng.uniform(low, high)
        mujoco.mj_kinematics(model, data)
        far = max(far, float(np.linalg.norm(data.geom_xpos, axis=1).max()))
    return far


def _placed(look: Look, reach: float, rng: np.random.Generator) -> Camera:
    side = rng.uniform(-0.9, -0.6)
    eye = np.array([1.75 * np.cos(side), 1.75 * np.sin(side), 0.95 + rng.uniform(-0.1, 0.1)]) * reach
    pose = looking_at(eye, np.array([0.16, -0.02, 0.1]) * reach, roll=rng.uniform(-0.03, 0.03))
    return pinhole(look.height, look.width, 0.74, pose)


def _stage(robot: RobotModel, camera: Camera, reach: float, table: float, rng: np.random.Generator) -> mujoco.MjModel:
    spec = robot.spec()
    for name in [one.name for one in spec.cameras]:
        spec.delete(spec.camera(name))
    materials(spec, rng)
    for geom in spec.geoms:
        light = float(np.mean(geom.rgba[:3]))
        geom.material = "reality_pale" if light > 0.6 else "reality_dark" if light < 0.35 else "reality_mark"
        geom.rgba = [1.0, 1.0, 1.0, 1.0]
    for site in spec.sites:
        site.rgba = [0.0, 0.0, 0.0, 0.0]
    world, k = spec.worldbody, reach
    plain = {"contype": 0, "conaffinity": 0, "mass": 0.0}
    box, plane = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_PLANE
    world.add_geom(type=box, size=[1.6 * k, 1.6 * k, 0.02 * k], pos=[0, 0, table - 0.02 * k], material="reality_wood", **plain)
    world.add_geom(type=plane, size=[6 * k, 6 * k, 1], pos=[-2.2 * k, 0, 0], zaxis=[1, 0, 0.02], material="reality_wall", **plain)
    world.add_geom(type=plane, size=[6 * k, 6 * k, 1], pos=[0, 2.2 * k, 0], zaxis=[0, -1, 0.02], material="reality_wall", **plain)
    world.add_geom(type=plane, size=[6 * k, 6 * k, 1], pos=[0, 0, table - 0.9 * k], material="reality_wall", **plain)
    column = [0.09 * k, 0.09 * k, -0.5 * table]
    world.add_geom(type=box, size=column, pos=[0, 0, 0.5 * table], material="reality_dark", **plain)
    world.add_geom(
        type=box, size=[0.16 * k, 0.11 * k, 0.1 * k], pos=[-0.75 * k, 0.8 * k, table + 0.1 * k], material="reality_mark", **plain
    )
    body = world.add_body(name="reality_thing", mocap=True)
    size = [THING.size[i] * reach / 0.75 for i in range(3)]
    body.add_geom(name="reality_thing", type=box, size=size, material="reality_thing", **plain)
    spot = {"castshadow": True, "diffuse": [0.75, 0.72, 0.66], "specular": [0.25] * 3, "ambient": [0.05] * 3}
    world.add_light(pos=[1.2 * k, -1.6 * k, 2.6 * k], dir=[-0.42, 0.55, -1.0], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, **spot)
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.3, 0.31, 0.34], [0.12] * 3
    spec.visual.quality.shadowsize, spec.visual.quality.offsamples = 1024, 0
    spec.visual.global_.offwidth, spec.visual.global_.offheight = camera.width * SCALE, camera.height * SCALE
    pose = camera.pose
    fovy = 2.0 * np.arctan(0.5 * camera.height / camera.intrinsics[1, 1])
    axes = (pose[:3, :3] * [1.0, -1.0, -1.0]).ravel()
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes)
    world.add_camera(name="reality_camera", pos=pose[:3, 3], quat=quat, fovy=float(np.degrees(fovy)))
    return spec.compile()


def materials(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """Textures and materials of everything that is to be seen, their tints by chance."""
    flat, checker, gradient = (getattr(mujoco.mjtBuiltin, f"mjBUILTIN_{n}") for n in ("FLAT", "CHECKER", "GRADIENT"))
    looks: Mapping[str, tuple] = {  # builtin, first colour, second colour, share of random marks, repeats, shine
        "wood": (checker, [0.62, 0.47, 0.33], [0.55, 0.41, 0.29], 0.08, [7.0, 7.0], 0.1),
        "wall": (gradient, [0.56, 0.62, 0.66], [0.46, 0.5, 0.56], 0.01, [1.0, 1.0], 0.0),
        "pale": (flat, [0.93, 0.88, 0.76], [0.93, 0.88, 0.76], 0.03, [1.0, 1.0], 0.6),
        "dark": (flat, [0.16, 0.2, 0.27], [0.16, 0.2, 0.27], 0.03, [1.0, 1.0], 0.7),
        "mark": (checker, [0.85, 0.45, 0.1], [0.7, 0.3, 0.08], 0.0, [2.0, 2.0], 0.3),
        "thing": (checker, [0.15, 0.32, 0.75], [0.92, 0.93, 0.88], 0.0, [0.5, 0.5], 0.2),
    }
    for name, (builtin, one, two, marks, repeats, shine) in looks.items():
        kind = mujoco.mjtTexture.mjTEXTURE_CUBE if name in ("pale", "dark", "mark", "thing") else mujoco.mjtTexture.mjTEXTURE_2D
        tint = rng.uniform(0.95, 1.05, 3)
        texture = spec.add_texture(name=f"reality_{name}", type=kind, builtin=builtin, width=128, height=128)
        texture.rgb1, texture.rgb2 = np.clip(one * tint, 0, 1), np.clip(two * tint, 0, 1)
        if marks:
            texture.mark, texture.random, texture.markrgb = mujoco.mjtMark.mjMARK_RANDOM, marks, 0.75 * np.asarray(one)
        material = spec.add_material(name=f"reality_{name}", texrepeat=repeats, texuniform=False, specular=shine, shininess=0.5)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = f"reality_{name}"


def _without(model: mujoco.MjModel) -> mujoco.MjModel:
    """The same scene with the robot invisible."""
    bare = copy.deepcopy(model)
    for geom in np.flatnonzero(bare.geom_bodyid != 0):
        bare.geom_matid[geom] = -1
        bare.geom_rgba[geom] = 0.0
    return bare
