"""Recordings of any published robot, made by a small world of this file's own, for `edream calibrate` and `edream diagnose`.

python benchmarks/stranger.py MODEL.xml OUT [--effect spring:joint2:20,0.3] [--seed 7] [--friction 2] [--armature 0.1]

The world shares nothing with edream: MuJoCo moves the rigid bodies at a quarter of a millisecond; servo (within the torque that the
model allows it), dry friction (a stiff bristle that slips) and the hidden effect are torques written here. Gains, dampings,
frictions and rotors are up to 30 % off what the model or the command line says. Motions keep clear of everything that the model
could touch. OUT gets one CSV a motion, and `OUT.truth.txt` stands beside it.
"""

import argparse
import csv
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

STEP = 0.00025  # s
SLIP, SLIDING = 1e-4, 1e-5  # rad (m) of a bristle before it slips, of a joint that turns (slides)
FIRM = 5e-4  # rad (m): a bristle is made for what the servo gives at this error, at least, as what is hidden may add to no friction
CLEARANCE = 0.01  # m
EFFECTS = {
    "stribeck": "torque [N m] above the dry friction at rest, speed [rad/s]",
    "load": "share of the servo's torque",
    "spring": "stiffness [N m/rad], angle [rad]",
    "drag": "torque at 1 rad/s [N m s^2/rad^2]",
    "cogging": "amplitude [N m], periods a turn",
    "saturation": "limit [N m]",
    "delay": "of the commands of every joint [s]",
    "offset": "of the encoder [rad]",
    "fade": "share of the servo's torque lost a second",
    "payload": "mass [kg], at the centre of the joint's link",
    "lag": "time constant of the command's filter [s]",
    "slew": "the command's largest speed [rad/s]",
    "deadzone": "error that the servo does not answer [rad]",
    "integral": "gain of the error's integral [N m/(rad s)]",
    "torque": "constant [N m]",
    "tilt": "of the base about x, then y [rad], whatever the joint",
    "asymmetry": "dry friction more forwards than backwards [N m]",
    "place": "dry friction [N m] more around an angle [rad], within a width [rad]",
    "coupling": "torque per angle of the joint before [N m/rad]",
    # what no library of effects is likely to have
    "stop": "a soft stop of a stiffness [N m/rad] beyond an angle [rad]",
    "hum": "torque [N m] at a frequency [Hz]",
    "weak": "share of the servo's gain that is missing around an angle [rad], within a width [rad]",
    "sticky": "dry friction [N m] more after a second at rest",
}


def main() -> None:
    """Record one robot."""
    told = "; ".join(f"{name}: {what}" for name, what in EFFECTS.items())
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], epilog=f"Effects, as NAME:JOINT:NUMBERS. {told}.")
    parser.add_argument("mjcf", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--effect", default=None)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--motions", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=50.0)
    parser.add_argument("--counts", type=int, default=4096, help="of the encoder, a turn")
    parser.add_argument(
        "--friction", type=float, default=None, help="true dry friction [N m], where the model's is not to be believed"
    )
    parser.add_argument("--armature", type=float, default=0.02, help="least true inertia of a rotor [kg m^2]")
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    world = World(given.mjcf, given.effect, rng, given.friction, given.armature)
    paths = Paths(world, rng)
    given.out.mkdir(parents=True)
    for number, command in enumerate([paths.plan(given.seconds, given.rate) for _ in range(given.motions)]):
        position = world.play(command, given.rate)
        step = np.where(world.turns, 2.0 * np.pi / given.counts, 1e-5)
        position = np.round((position + rng.normal(0.0, 0.1, position.shape) * step) / step) * step
        times = np.arange(len(command)) / given.rate + np.r_[0.0, rng.normal(0.0, 2e-4, len(command) - 1)]
        with open(given.out / f"motion_{number:02d}.csv", "w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(["time", *(f"command_{n}" for n in world.names), *(f"position_{n}" for n in world.names)])
            rows.writerows([[f"{x:.6f}" for x in (t, *c, *p)] for t, c, p in zip(times, command, position, strict=True)])
    given.out.with_suffix(".truth.txt").write_text(world.truth(), encoding="utf-8")


class World:
    """Servos and frictions of a robot whose rigid bodies MuJoCo moves.

    Args:
        mjcf: the published model; each actuator drives a hinge or slide joint by a position servo.
        effect: what is hidden, NAME:JOINT:NUMBERS, or None.
        rng: draws what is true.
        friction, armature: see the command line.
    """

    def __init__(self, mjcf: Path, effect: str | None, rng: np.random.Generator, friction: float | None, armature: float) -> None:
        self.model = model = mujoco.MjModel.from_xml_path(str(mjcf))
        joints = [int(model.actuator(i).trnid[0]) for i in range(model.nu)]
        self.names = [model.joint(j).name for j in joints]
        self.dof, self.qpos = model.jnt_dofadr[joints], model.jnt_qposadr[joints]
        self.turns = model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_HINGE
        limited = model.jnt_limited[joints].astype(bool) & (model.jnt_range[joints, 1] > model.jnt_range[joints, 0])
        self.low = np.where(limited, np.maximum(model.jnt_range[joints, 0], -1.5), -1.5)
        self.high = np.where(limited, np.minimum(model.jnt_range[joints, 1], 1.5), 1.5)

        def off(nominal: np.ndarray) -> np.ndarray:
            return nominal * np.exp(rng.uniform(-0.3, 0.3, len(joints)))

        self.least, self.most = np.full(len(joints), -np.inf), np.full(len(joints), np.inf)
        of_joints = model.jnt_actfrcrange[joints], model.jnt_actfrclimited[joints]
        for ranges, given in ((model.actuator_forcerange, model.actuator_forcelimited), of_joints):
            self.least = np.where(given.astype(bool), np.maximum(self.least, ranges[:, 0]), self.least)
            self.most = np.where(given.astype(bool), np.minimum(self.most, ranges[:, 1]), self.most)
        self.kp = off(-model.actuator_biasprm[:, 1])
        # the servo's damping is within its torque limit, the joint's is not; where the model has neither, the servo damps
        own, passive = np.maximum(-model.actuator_biasprm[:, 2], 0.0), model.dof_damping[self.dof]
        own = np.where(own + passive > 0.0, own, 0.04 * self.kp)
        self.kd = off(own + passive)
        self.drag = self.kd * passive / (own + passive)
        self.kd -= self.drag
        published = np.maximum(model.dof_frictionloss[self.dof], 1e-3)
        self.slip = off(published if friction is None else np.where(self.turns, friction, 3.0))
        self.rotor = off(np.maximum(model.dof_armature[self.dof], armature))
        self.effect, where, numbers = (*effect.split(":"), "")[:3] if effect else ("", "", "")
        if where and where not in self.names:
            raise SystemExit(f"--effect {effect}: no actuator drives a joint {where!r}; what exists: {', '.join(self.names)}.")
        self.at = self.names.index(where) if where else -1
        self.numbers = [float(x) for x in numbers.split(",")] if numbers else []
        model.dof_armature[self.dof], model.dof_frictionloss[self.dof], model.dof_damping[self.dof] = self.rotor, 0.0, 0.0
        model.actuator_gainprm[:], model.actuator_biasprm[:] = 0.0, 0.0
        model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_EULER
        if self.effect == "payload":
            model.body_mass[model.jnt_bodyid[joints[self.at]]] += self.numbers[0]
            mujoco.mj_setConst(model, mujoco.MjData(model))
        if self.effect == "tilt":
            turn = np.zeros(4)
            mujoco.mju_euler2Quat(turn, np.array([*self.numbers, 0.0]), "xyz")
            mujoco.mju_rotVecQuat(model.opt.gravity, model.opt.gravity.copy(), turn)
        # how the hidden effect remembers: the command as the servo has it, the error's integral, how long the joint has rested
        self.told, self.sum, self.rested = 0.0, 0.0, 0.0

    def truth(self) -> str:
        """What is true, in words."""
        rows = zip(self.names, self.kp, self.kd + self.drag, self.slip, self.rotor, strict=True)
        usual = [f"{n}: kp {a:.4g}, damping {b:.4g}, friction {c:.4g}, rotor {d:.4g}" for n, a, b, c, d in rows]
        return "\n".join(
            [f"hidden: {self.effect or 'nothing'} {self.names[self.at] if self.at >= 0 else ''} {self.numbers}", *usual, ""]
        )

    def play(self, command: np.ndarray, rate: float) -> np.ndarray:
        """Where the joints are when each command is given, (rows, J), after two seconds at the first of them."""
        data = mujoco.MjData(self.model)
        data.qpos[self.qpos] = command[0]
        hold, settle = round(1.0 / rate / STEP), round(2.0 / STEP)
        late = round(self.numbers[0] / STEP) if self.effect == "delay" else 0
        bristle, rows = np.zeros(len(self.names)), []
        self.told, self.sum, self.rested = float(command[0][self.at]), 0.0, 0.0
        for k in range(-settle, len(command) * hold):
            if k >= 0 and k % hold == 0:
                rows.append(data.qpos[self.qpos].copy())
            q, v = data.qpos[self.qpos], data.qvel[self.dof]
            error = self._commanded(command[max(k - late, 0) // hold]) - q
            torque = np.clip(self._served(error, v), self.least, self.most)
            torque, slip = self._hidden(torque, q, v, max(k, 0) * STEP)
            stiffness = np.maximum(self.slip, FIRM * self.kp) / np.where(self.turns, SLIP, SLIDING)
            bristle = np.clip(bristle + v * STEP, -slip / stiffness, slip / stiffness)
            stuck = np.abs(bristle) < 0.999 * slip / stiffness
            friction = stiffness * bristle + 0.02 * np.sqrt(stiffness * self.rotor) * v * stuck
            data.qfrc_applied[self.dof] = torque - self.drag * v - friction
            mujoco.mj_step(self.model, data)
            if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
                raise SystemExit("The world became unstable; ask for a larger --armature.")
        shown = np.array(rows)
        if self.effect == "offset":
            shown[:, self.at] += self.numbers[0]
        return shown

    def _commanded(self, command: np.ndarray) -> np.ndarray:
        """The command as the servos have it."""
        told, x = command.copy(), self.numbers
        if self.effect == "lag":
            self.told += (command[self.at] - self.told) * STEP / x[0]
        elif self.effect == "slew":
            self.told += np.clip(command[self.at] - self.told, -x[0] * STEP, x[0] * STEP)
        if self.effect in ("lag", "slew"):
            told[self.at] = self.told
        return told

    def _served(self, error: np.ndarray, v: np.ndarray) -> np.ndarray:
        """What the servos make of an error, before their limits."""
        error, j, x = error.copy(), self.at, self.numbers
        if self.effect == "deadzone":
            error[j] -= np.clip(error[j], -x[0], x[0])
        torque = self.kp * error - self.kd * v
        if self.effect == "integral":
            self.sum = float(np.clip(self.sum + error[j] * STEP, -1.0, 1.0))
            torque[j] += x[0] * self.sum
        return torque

    def _hidden(self, torque: np.ndarray, q: np.ndarray, v: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
        """The servo's torque and the friction's limit with what is hidden."""
        j, x, slip = self.at, self.numbers, self.slip.copy()
        act: dict[str, Callable[[], float]] = {
            "spring": lambda: -x[0] * (q[j] - x[1]),
            "drag": lambda: -x[0] * v[j] * abs(v[j]),
            "cogging": lambda: -x[0] * np.sin(x[1] * q[j]),
            "saturation": lambda: np.clip(torque[j], -x[0], x[0]) - torque[j],
            "fade": lambda: -torque[j] * x[0] * time,
            "torque": lambda: x[0],
            "coupling": lambda: -x[0] * q[j - 1],
            "stop": lambda: -x[0] * max(0.0, q[j] - x[1]),
            "hum": lambda: x[0] * np.sin(2.0 * np.pi * x[1] * time),
            "weak": lambda: -torque[j] * x[0] * np.exp(-(((q[j] - x[1]) / x[2]) ** 2)),
        }
        if self.effect == "stribeck":
            slip[j] += x[0] * np.exp(-((v[j] / x[1]) ** 2))
        elif self.effect == "load":
            slip[j] += x[0] * abs(torque[j])
        elif self.effect == "asymmetry":
            slip[j] += x[0] / 2.0 if v[j] > 0.0 else -x[0] / 2.0
        elif self.effect == "place":
            slip[j] += x[0] * np.exp(-(((q[j] - x[1]) / x[2]) ** 2))
        elif self.effect == "sticky":
            self.rested = np.clip(self.rested + (STEP if abs(v[j]) < 0.02 else -5.0 * STEP), 0.0, 1.0)
            slip[j] += x[0] * self.rested
        elif self.effect in act:
            torque[j] += act[self.effect]()
        return torque, slip


class Paths:
    """Smooth moves between poses that nothing touches, with rests, about the pose with the most room."""

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        self.world, self.rng, self.data = world, rng, mujoco.MjData(world.model)
        always = [self._touching(rng.uniform(world.low, world.high)) for _ in range(60)]
        self.known = set.intersection(*always)  # links that overlap in every pose
        self.reach = np.where(world.turns, np.minimum(0.6, 0.5 * (world.high - world.low)), 0.45 * (world.high - world.low))
        poses = [rng.uniform(world.low + self.reach, world.high - self.reach + 1e-9) for _ in range(80)]
        near = rng.uniform(-1.0, 1.0, (30, len(self.reach))) * self.reach
        self.middle = max(poses, key=lambda pose: self.clear(pose) * sum(self.clear(pose + way) for way in near))

    def _touching(self, pose: np.ndarray) -> set[tuple[int, int]]:
        model, data = self.world.model, self.data
        margin = model.geom_margin.copy()
        model.geom_margin[:] = CLEARANCE
        data.qpos[self.world.qpos] = pose
        mujoco.mj_fwdPosition(model, data)
        model.geom_margin[:] = margin
        return {tuple(sorted((int(c.geom1), int(c.geom2)))) for c in data.contact}  # type: ignore[misc]

    def clear(self, pose: np.ndarray) -> bool:
        """Whether a pose touches nothing that is not always touched."""
        return not self._touching(np.clip(pose, self.world.low, self.world.high)) - self.known

    def plan(self, seconds: float, rate: float) -> np.ndarray:
        """Commands, (rows, J)."""
        here, rows = self._next(None), round(seconds * rate)
        parts = [np.tile(here, (round(0.4 * rate), 1))]
        while sum(map(len, parts)) < rows:
            there = self._next(here)
            far = float(np.max(np.abs(there - here) / np.where(self.world.turns, 1.0, 0.05)))
            s = np.linspace(0.0, 1.0, max(4, int(rate * far / self.rng.uniform(0.4, 2.0))))[:, None]
            parts += [here + (there - here) * (10 * s**3 - 15 * s**4 + 6 * s**5)]
            parts += [np.tile(there, (int(self.rng.integers(1, int(0.6 * rate))), 1))]
            here = there
        return np.concatenate(parts)[:rows]

    def _next(self, here: np.ndarray | None) -> np.ndarray:
        for _ in range(300):
            there = self.middle + self.reach * self.rng.uniform(-1.0, 1.0, len(self.reach))
            there = np.clip(there, self.world.low, self.world.high)
            if here is not None:
                there = np.where(self.rng.random(len(there)) < 0.3, here, there)
            way = np.linspace(there if here is None else here, there, 12)
            if all(self.clear(pose) for pose in way):
                return there
        raise SystemExit("There is no clear way from one pose to another; the model touches itself almost everywhere.")


if __name__ == "__main__":
    main()
