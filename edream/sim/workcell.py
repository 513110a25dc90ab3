"""The simulated workcell: any MJCF of a robot, published or calibrated, with a task's table and things added to it."""

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.bench import Arm, bench_of
from edream.core.effect import MEASURED_SUFFIX, MOTOR_SUFFIX, joint_index
from edream.core.errors import EdreamError
from edream.core.policy import Conditions, Observation, Outcome, StartNoise, World
from edream.core.task import Layout, Scene, Task, Thing, pinched
from edream.sim.eyes import DECOR, PARTS, PROXIES, Eyes, Images, furnish_views
from edream.sim.open_loop import load_hook
from edream.sim.quiet import quiet
from edream.sim.robot import RobotModel

SETTLE = 0.4  # the robot rests at its first command before a trial begins [s]
FIRM = ([0.008, 1.0], [0.95, 0.99, 0.001, 0.5, 2.0])  # solref, solimp of every contact: pads that give less than a millimetre
SHAPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}
THING = "task_"


class SimulatedWorkcell(World):
    """A robot at its bench in MuJoCo.

    Args:
        robot: the model to simulate; its name says which bench it stands at.
        task: what lies on the bench.
        rate: control steps per second [Hz].
        images: what is seen; no cameras where None.
        hook: the hook file that came with a calibrated model.
        grip: factor on all contact friction, for calibrated contact or for variation.

    Raises:
        EdreamError: the robot has no bench, a camera does not exist, or this machine cannot render.
    """

    def __init__(
        self,
        robot: RobotModel,
        task: Task,
        rate: float = 25.0,
        images: Images | None = None,
        hook: Path | None = None,
        grip: float = 1.0,
    ) -> None:
        self.robot, self.task, self.rate, self.seconds = robot, task, float(rate), task.seconds
        self.images, self.grip = images or Images(cameras=()), grip
        self.bench = bench_of(robot.name)
        self.actions, self.cameras = len(robot.joints), self.images.cameras if self.images.raw else ()
        self.low, self.high = _limits(robot)
        self._make = None if hook is None else load_hook(hook).make
        self._eyes: Eyes | None = None
        self.reset(0)

    def reset(self, start: int, noise: StartNoise | None = None) -> Observation:
        layout = self.task.layout(start, self.bench.arms)
        chance = np.random.default_rng(np.random.SeedSequence((noise.seed, 0x5EED))) if noise else None
        shift = _shifts(layout, chance, noise.objects) if noise and chance is not None else {}
        spec = self.robot.spec()
        furnish(spec, self.bench.table, self.bench.arms, layout, self.grip)
        furnish_views(spec, self.bench, self.images)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._hook = None if self._make is None else self._make(self.model)
        self._index = [joint_index(self.model, joint) for joint in self.robot.joints]
        self._ctrl = np.array([one["ctrl"] for one in self._index])
        self._qpos = np.array([one["qpos"] for one in self._index])
        self._measured = _sensors(self.model, self.robot.joints)
        self._bodies = {thing.name: int(self.model.body(THING + thing.name).id) for thing in layout.things}
        self._touching = Touching(self.model, self.bench.arms)
        self._hand = int(self.model.site(self.bench.arms[layout.arm].site).id)
        for thing in layout.things:
            if not thing.fixed:
                joint = self.model.joint(THING + thing.name)
                self.data.qpos[joint.qposadr[0] : joint.qposadr[0] + 7] = thing.pose + shift.get(thing.name, 0.0)
        rest = self._rest(chance, noise.joints if noise else 0.0)
        self.data.qpos[self._qpos] = rest
        for joint, place in zip(self.robot.joints, rest, strict=True):
            motor = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, joint + MOTOR_SUFFIX)
            if motor >= 0:
                self.data.qpos[self.model.jnt_qposadr[motor]] = place
        self._taken = 0
        self._run(rest, round(SETTLE / self.model.opt.timestep))
        self._settled = self.data.time
        self.scene = Scene(layout, self.state(), self.data.site_xpos[self._hand].copy())
        return self._observe()

    def step(self, action: Float[np.ndarray, "A"]) -> Observation:
        self._taken += 1
        wanted = round((self._settled + self._taken / self.rate - self.data.time) / self.model.opt.timestep)
        self._run(checked(action, self.low, self.high), wanted)
        self.scene.see(self.state(), self.data.site_xpos[self._hand].copy(), self._touching.pinched(self.data))
        return self._observe()

    def hand(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Privileged: where the working hand is [m], and its axes as columns."""
        data = self.data
        return data.site_xpos[self._hand].copy(), data.site_xmat[self._hand].reshape(3, 3).copy()

    def outcome(self) -> Outcome:
        return self.task.outcome(self.scene)

    def state(self) -> Mapping[str, Float[np.ndarray, "7"]]:
        return {name: np.concatenate([self.data.xpos[body], self.data.xquat[body]]) for name, body in self._bodies.items()}

    def conditions(self) -> Mapping[str, Conditions]:
        return self._look().conditions(self.model, self.data)

    def cutouts(self) -> Mapping[str, tuple[np.ndarray, np.ndarray]]:
        """Robot and things as `conditions` has them, (H, W, 3), and the share of each pixel that they cover, 0..255, (H, W)."""
        return self._look().cutouts(self.model, self.data)

    def raw(self) -> Mapping[str, np.ndarray]:
        """The raw rendering of every camera, (H, W, 3)."""
        return self._look().colours(self.model, self.data)

    def close(self) -> None:
        if self._eyes is not None:
            self._eyes.close()
            self._eyes = None

    def _rest(self, chance: np.random.Generator | None, spread: float) -> np.ndarray:
        rest = np.zeros(self.actions)
        for arm in self.bench.arms:
            rest[[self.robot.joint_index(name) for name in (*arm.joints, arm.gripper)]] = [*arm.home, arm.most]
            if chance is not None:
                rest[[self.robot.joint_index(name) for name in arm.joints]] += spread * chance.standard_normal(len(arm.joints))
        return np.clip(rest, self.low, self.high)

    def _run(self, command: np.ndarray, steps: int) -> None:
        self.data.ctrl[self._ctrl] = command
        with quiet():
            if self._hook is None:
                mujoco.mj_step(self.model, self.data, steps)
            else:
                for _ in range(steps):
                    self._hook(self.model, self.data)
                    mujoco.mj_step(self.model, self.data)
            mujoco.mj_fwdPosition(self.model, self.data)

    def _observe(self) -> Observation:
        joints = self.data.qpos[self._qpos].copy() if self._measured is None else self.data.sensordata[self._measured].copy()
        return Observation(joints, self.raw() if self.cameras else {})

    def _look(self) -> Eyes:
        if self._eyes is None:
            self._eyes = Eyes(self.model, self.images)
        return self._eyes


class Touching:
    """Which things are between both fingers of an arm."""

    def __init__(self, model: mujoco.MjModel, arms: tuple[Arm, ...]) -> None:
        self.finger = np.full(model.ngeom, -1)
        for number, arm in enumerate(arms):
            moving = int(model.joint(arm.gripper).bodyid[0])
            for side, body in enumerate((int(model.body_parentid[moving]), moving)):
                self.finger[(model.geom_bodyid == body) & (model.geom_contype != 0)] = 2 * number + side
        names = [model.body(body).name for body in model.geom_bodyid]
        self.thing = [name.removeprefix(THING) if name.startswith(THING) else None for name in names]

    def pinched(self, data: mujoco.MjData) -> frozenset[str]:
        """Their names."""
        return pinched(data.contact.geom[: data.ncon], self.finger, self.thing)


def furnish(
    spec: mujoco.MjSpec,
    table: tuple[tuple[float, float, float], tuple[float, float, float]],
    arms: tuple[Arm, ...],
    layout: Layout,
    grip: float,
) -> None:
    """Add a table and things to a robot's spec, and give its fingers pads. Nothing is held by anything but contact."""
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
    for key in list(spec.keys):
        spec.delete(key)
    for site in spec.sites:
        site.rgba = [0.0, 0.0, 0.0, 0.0]
    for geom in spec.geoms:
        if geom.group >= PROXIES:
            geom.rgba, geom.material = [0.0, 0.0, 0.0, 0.0], ""
        if geom.parent.name == "world":
            geom.group = DECOR
    for arm in arms:
        moving = spec.joint(arm.gripper).parent
        for body in (moving, moving.parent):
            for geom in body.geoms:
                geom.contype, geom.conaffinity, geom.priority, geom.condim = 2, 1, 1, 4
                geom.friction = [grip * layout.grip, 0.006, 0.0001]
                geom.solref, geom.solimp = FIRM
    top = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=table[0], pos=table[1], rgba=[0.55, 0.5, 0.45, 1.0])
    top.contype, top.conaffinity, top.group, top.friction = 1, 0, DECOR, [0.05, 0.003, 0.0001]
    top.solref, top.solimp = FIRM
    for thing in layout.things:
        _add(spec, thing, grip)


def _add(spec: mujoco.MjSpec, thing: Thing, grip: float) -> None:
    body = spec.worldbody.add_body(name=THING + thing.name, pos=thing.pose[:3], quat=thing.pose[3:])
    if not thing.fixed:
        body.add_freejoint(name=THING + thing.name)
    rgba = [*thing.proxy.colour, 1.0]
    volumes = np.array([_volume(part.shape, part.size) for part in thing.parts])
    for part, volume in zip(thing.parts, volumes, strict=True):
        geom = body.add_geom(type=SHAPES[part.shape], size=_three(part.size), pos=part.pos, quat=part.quat, rgba=rgba, group=PARTS)
        geom.contype, geom.conaffinity, geom.condim = 1, 3, 4
        geom.mass, geom.friction = thing.mass * volume / volumes.sum(), [grip * thing.friction, 0.003, 0.0001]
        geom.solref, geom.solimp = FIRM
    plain = body.add_geom(type=SHAPES[thing.proxy.shape], size=thing.proxy.size3, rgba=rgba, group=PROXIES, mass=0.0)
    plain.contype, plain.conaffinity = 0, 0


def checked(action: Float[np.ndarray, "A"], low: np.ndarray, high: np.ndarray) -> Float[np.ndarray, "A"]:
    """An action as the actuators can take it.

    Raises:
        EdreamError: it has another length or a value that is not finite.
    """
    action = np.asarray(action, dtype=float)
    if action.shape != low.shape or not np.isfinite(action).all():
        raise EdreamError(f"An action has shape {action.shape} and {np.isfinite(action).sum()} finite values; expected {len(low)}.")
    return np.clip(action, low, high)


def _limits(robot: RobotModel) -> tuple[np.ndarray, np.ndarray]:
    model = robot.model
    index = [joint_index(model, joint)["ctrl"] for joint in robot.joints]
    numbers = [
        next(a for a in range(model.nactuator) if model.actuator_ctrladr[a] == one and model.actuator_ctrlnum[a]) for one in index
    ]
    low, high = model.actuator_ctrlrange[numbers].T
    return low.copy(), high.copy()


def _sensors(model: mujoco.MjModel, joints: tuple[str, ...]) -> np.ndarray | None:
    found = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, joint + MEASURED_SUFFIX) for joint in joints]
    return np.array([model.sensor_adr[one] for one in found]) if min(found) >= 0 else None


def _shifts(layout: Layout, chance: np.random.Generator, spread: float) -> dict[str, np.ndarray]:
    return {
        thing.name: np.concatenate([spread * chance.standard_normal(2), np.zeros(5)]) for thing in layout.things if not thing.fixed
    }


def _volume(shape: str, size: tuple[float, ...]) -> float:
    if shape == "box":
        return 8.0 * size[0] * size[1] * size[2]
    if shape == "sphere":
        return 4.0 / 3.0 * np.pi * size[0] ** 3
    round_ends = 4.0 / 3.0 * np.pi * size[0] ** 3 if shape == "capsule" else 0.0
    return float(2.0 * np.pi * size[0] ** 2 * size[1] + round_ends)


def _three(size: tuple[float, ...]) -> list[float]:
    return [*size, *[0.0] * (3 - len(size))]
