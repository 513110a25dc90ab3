"""The make-believe real workcell: the hidden robot at its bench, its own contacts, its own look."""

from collections.abc import Iterator, Mapping

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.bench import Arm, bench_of
from edream.core.effect import joint_index
from edream.core.errors import EdreamError
from edream.core.policy import Observation, Outcome, StartNoise, World
from edream.core.task import Scene, Task, Thing, pinched
from edream.reality.cell_look import CellLook, Lens, dress
from edream.reality.recorder import Recorder
from edream.reality.session import Session, hollow
from edream.reality.truth import Truth
from edream.sim.robot import RobotModel

SETTLE = 0.6  # the robot rests at its first command before a trial begins [s]
STEP = 0.001  # [s]
THING = "thing_"
SHAPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
}
CONTACT = ([0.006, 1.0], [0.96, 0.99, 0.001, 0.5, 2.0])  # solref, solimp


class Glance(Mapping[str, np.ndarray]):
    """The images of one moment, taken when one of them is first asked for: most steps of a policy look at none.

    Raises:
        EdreamError: they are asked for only after the world has moved on.
    """

    def __init__(self, world: "RealWorkcell", time: float) -> None:
        self._world, self._time, self._moment = world, time, world.moment
        self._taken: Mapping[str, np.ndarray] | None = None

    def __getitem__(self, name: str) -> np.ndarray:
        if self._taken is None:
            if self._world.moment != self._moment:
                raise EdreamError("An image of an earlier step was asked for; look before the next step.")
            self._taken = self._world.see(self._time)
        return self._taken[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._world.cameras)

    def __len__(self) -> int:
        return len(self._world.cameras)


class RealWorkcell(World):
    """The hidden robot and a task's things. It has no `conditions`: nobody knows which pixel of a photograph shows what.

    Args:
        robot: the nominal robot; its name says which bench it stands at.
        truth: what is true of robot and workcell.
        task: what lies on the bench.
        rate: control steps per second [Hz].
        look: its cameras; none where None. A caller sees to the graphics.
        recorder: noise and resolution of the encoders.

    Raises:
        EdreamError: the robot has no bench, the truth is of another robot, or it hides what robots among things do not have.
    """

    def __init__(
        self,
        robot: RobotModel,
        truth: Truth,
        task: Task,
        rate: float = 25.0,
        look: CellLook | None = None,
        recorder: Recorder | None = None,
    ) -> None:
        if truth.robot != robot.name:
            raise EdreamError(f"This truth is of robot {truth.robot!r}, not {robot.name!r}.")
        self.robot, self.truth, self.task, self.rate, self.seconds = robot, truth, task, float(rate), task.seconds
        self.bench, self.look, self.recorder = bench_of(robot.name), look, recorder or Recorder()
        self.actions, self.cameras = len(robot.joints), look.cameras if look else ()
        nominal = robot.model
        self._names = [nominal.joint(i).name for i in range(nominal.njnt)]
        self._order = np.array([self._names.index(joint) for joint in robot.joints])
        ctrl = [joint_index(nominal, joint)["ctrl"] for joint in robot.joints]
        self.low, self.high = (np.array(side) for side in nominal.actuator_ctrlrange[ctrl].T)
        slide = np.asarray(nominal.jnt_type) == int(mujoco.mjtJoint.mjJNT_SLIDE)
        full = np.where(slide, nominal.jnt_range[:, 1] - nominal.jnt_range[:, 0], 2.0 * np.pi)
        self._count, self._noise = full / self.recorder.counts, self.recorder.noise * np.where(slide, full, 1.0)
        self._lens: Lens | None = None
        self.moment = 0
        self._seed = int(truth.cell.get("look", 0))
        self.reset(0)

    def reset(self, start: int, noise: StartNoise | None = None) -> Observation:
        layout = self.task.layout(start, self.bench.arms)
        model = self._model(layout.things, layout.grip, start)
        self._chance = np.random.default_rng(np.random.SeedSequence((self._seed, start, noise.seed if noise else 0)))
        self.session = Session(model, self._names, self.truth, self.robot.model)
        self._bodies = {thing.name: int(model.body(THING + thing.name).id) for thing in layout.things}
        self._finger, self._thing = _fingers(model, self.bench.arms), _things(model)
        self._hand = int(model.site(self.bench.arms[layout.arm].site).id)
        for thing in layout.things:
            if not thing.fixed:
                at = model.joint(THING + thing.name).qposadr[0]
                self.session.data.qpos[at : at + 7] = thing.pose
                if noise:
                    self.session.data.qpos[at : at + 2] += noise.objects * self._chance.standard_normal(2)
        rest = np.zeros(self.actions)
        for arm in self.bench.arms:
            rest[[self.robot.joint_index(name) for name in (*arm.joints, arm.gripper)]] = [*arm.home, arm.most]
            if noise:
                rest[[self.robot.joint_index(n) for n in arm.joints]] += noise.joints * self._chance.standard_normal(
                    len(arm.joints)
                )
        self._taken, self.moment = 0, self.moment + 1
        self.session.rest(self._inside(np.clip(rest, self.low, self.high)), SETTLE)
        self.scene = Scene(layout, self.state(), self.session.data.site_xpos[self._hand].copy())
        if self.look is not None:
            self._lens = self._lens or Lens(model, self.look)
            self._lens.begin(int(self._chance.integers(2**31)))
        return self._observe()

    def step(self, action: Float[np.ndarray, "A"]) -> Observation:
        action = np.asarray(action, dtype=float)
        if action.shape != self.low.shape or not np.isfinite(action).all():
            raise EdreamError(f"An action has shape {action.shape}; expected {self.actions} finite numbers.")
        self._taken, self.moment = self._taken + 1, self.moment + 1
        self.session.run(self._inside(np.clip(action, self.low, self.high)), SETTLE + self._taken / self.rate)
        data = self.session.data
        found = pinched(data.contact.geom[: data.ncon], self._finger, self._thing)
        self.scene.see(self.state(), data.site_xpos[self._hand].copy(), found)
        return self._observe()

    def hand(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """Privileged: where the working hand is [m], and its axes as columns."""
        data = self.session.data
        return data.site_xpos[self._hand].copy(), data.site_xmat[self._hand].reshape(3, 3).copy()

    def outcome(self) -> Outcome:
        return self.task.outcome(self.scene)

    def state(self) -> Mapping[str, Float[np.ndarray, "7"]]:
        data = self.session.data
        return {name: np.concatenate([data.xpos[body], data.xquat[body]]) for name, body in self._bodies.items()}

    def photograph(self) -> Mapping[str, np.ndarray]:
        """The bench without robot and things, as one would photograph it beforehand, (H, W, 3) for each camera."""
        look = self.look or CellLook()
        spec = self.robot.spec()
        for geom in spec.geoms:
            geom.rgba = [0.0, 0.0, 0.0, 0.0]
        dress(spec, self.bench, None, look, self._seed)
        for geom in spec.geoms:
            if geom.rgba[3] == 0.0 or geom.parent.name != "world":
                geom.material, geom.rgba = "", [0.0, 0.0, 0.0, 0.0]
        model = spec.compile()
        data, lens = mujoco.MjData(model), Lens(model, look)
        mujoco.mj_forward(model, data)
        seen = lens.see(model, data, 0.0, clean=True)
        lens.close()
        return seen

    def close(self) -> None:
        if self._lens is not None:
            self._lens.close()
            self._lens = None

    def _inside(self, command: np.ndarray) -> np.ndarray:
        """A command in the order of the model's joints."""
        out = np.zeros(len(self._names))
        out[self._order] = command
        return out

    def _observe(self) -> Observation:
        noisy = self.session.encoder() + self._noise * self._chance.standard_normal(len(self._names))
        joints = (np.round(noisy / self._count) * self._count)[self._order]
        time = self._taken / self.rate
        return Observation(joints, Glance(self, time) if self._lens else {})

    def see(self, time: float) -> Mapping[str, np.ndarray]:
        """What the cameras show now, `time` seconds into the trial."""
        return self._lens.see(self.session.model, self.session.data, time) if self._lens else {}

    def _model(self, things: tuple[Thing, ...], grip: float, start: int) -> mujoco.MjModel:
        spec = self.robot.spec()
        hollow(spec, self.truth, self.robot.model, STEP)
        spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
        for key in list(spec.keys):
            spec.delete(key)
        slip = self.truth.cell.get("grip", 1.0)
        for arm in self.bench.arms:
            moving = spec.joint(arm.gripper).parent
            for geom in (*moving.geoms, *moving.parent.geoms):
                geom.contype, geom.conaffinity, geom.priority, geom.condim = 2, 1, 1, 4
                geom.friction, (geom.solref, geom.solimp) = [slip * grip, 0.006, 0.0001], CONTACT
        layout = self.task.layout(start, self.bench.arms)
        dress(spec, self.bench, layout if self.look else None, self.look or CellLook(), self._seed)
        table = spec.geom("table")
        table.friction, (table.solref, table.solimp) = [0.05, 0.003, 0.0001], CONTACT
        for thing in things:
            _lay(spec, thing, slip, self.truth.cell.get("mass", 1.0), self.look is not None)
        return spec.compile()


def _lay(spec: mujoco.MjSpec, thing: Thing, slip: float, weight: float, seen: bool) -> None:
    body = spec.worldbody.add_body(name=THING + thing.name, pos=thing.pose[:3], quat=thing.pose[3:])
    if not thing.fixed:
        body.add_freejoint(name=THING + thing.name)
    geoms = []
    for part in thing.parts:
        size = [*part.size, *[0.0] * (3 - len(part.size))]
        geom = body.add_geom(type=SHAPES[part.shape], size=size, pos=part.pos, quat=part.quat)
        geom.contype, geom.conaffinity, geom.condim = 1, 3, 4
        geom.friction, (geom.solref, geom.solimp) = [slip * thing.friction, 0.003, 0.0001], CONTACT
        if seen:
            geom.material = THING + thing.name
        geoms.append((geom, _volume(part.shape, part.size)))
    for geom, volume in geoms:
        geom.mass = weight * thing.mass * volume / sum(v for _, v in geoms)


def _volume(shape: str, size: tuple[float, ...]) -> float:
    ball = 4.0 / 3.0 * np.pi * size[0] ** 3
    rod = 2.0 * np.pi * size[0] ** 2 * size[-1]
    return float({"box": 8.0 * np.prod(size), "sphere": ball, "cylinder": rod, "capsule": rod + ball}[shape])


def _fingers(model: mujoco.MjModel, arms: tuple[Arm, ...]) -> np.ndarray:
    finger = np.full(model.ngeom, -1)
    for number, arm in enumerate(arms):
        moving = int(model.joint(arm.gripper).bodyid[0])
        for side, body in enumerate((int(model.body_parentid[moving]), moving)):
            finger[(model.geom_bodyid == body) & (model.geom_contype != 0)] = 2 * number + side
    return finger


def _things(model: mujoco.MjModel) -> list[str | None]:
    names = [model.body(body).name for body in model.geom_bodyid]
    return [name.removeprefix(THING) if name.startswith(THING) else None for name in names]
