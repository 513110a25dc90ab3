"""Recordings of a lamp with three joints, in plain MuJoCo, in which something happens that a library of effects hardly has.

python -m benchmarks.odd_lamp OUT CASE [--seed 1]

An outsider's world: MuJoCo's own dry friction, soft as it comes, at half a millisecond; gains, dampings, frictions and rotors are
not the published ones; 0.3 mrad of noise. OUT gets `robot.xml`, as published, and `data`, one CSV a motion. Then:
edream diagnose robot.mjcf=OUT/robot.xml data=OUT/data
"""

import argparse
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.plain_mujoco import write_motion

STEP, PERIOD, SECONDS, MOTIONS = 0.0005, 0.02, 10.0, 10  # s, s, s
SETTLING = 4000  # steps before a recording
NOISE = 3e-4  # rad
JOINTS = ("yaw", "shoulder", "elbow")
REACH = (1.2, 0.9, 1.3)  # rad
LAMP = """<mujoco model="lamp"><compiler angle="radian"/><option timestep="{dt}" integrator="implicitfast"/><worldbody>
<body name="base"><geom type="cylinder" size=".06 .03" mass="{base_mass}"/>{floor}
<body name="b1" pos="0 0 .05"><joint name="yaw" axis="0 0 1" range="-2.5 2.5" {yaw}/>
 <geom type="capsule" fromto="0 0 0 0 0 .1" size=".03" mass=".5"/>
<body name="b2" pos="0 0 .1"><joint name="shoulder" axis="0 1 0" range="-1.6 1.6" {shoulder}/>
 <geom type="capsule" fromto="0 0 0 0 0 .25" size=".025" mass=".6"/>
<body name="b3" pos="0 0 .25"><joint name="elbow" axis="0 1 0" range="-2.2 2.2" {elbow}/>
 <geom type="capsule" fromto="0 0 0 0 0 .2" size=".02" mass=".35"/>
<body name="tool" pos="0 0 .2"><geom type="sphere" size=".03" mass=".1"/></body></body></body></body></body></worldbody>
<actuator>{servos}</actuator></mujoco>"""
PUBLISHED = {"damping": (0.1, 0.1, 0.1), "frictionloss": (0.05, 0.05, 0.05), "armature": (0.02, 0.02, 0.01)}
PUBLISHED |= {"kp": (40, 40, 25), "kv": (1, 1, 0.6)}
TRUE = {"damping": (0.13, 0.08, 0.12), "frictionloss": (0.12, 0.1, 0.08), "armature": (0.026, 0.017, 0.013)}
TRUE |= {"kp": (34, 46, 22), "kv": (1.2, 0.9, 0.7)}
SHAKY = "".join(
    f'<joint name="w{i}" axis="{axis}" pos="0 0 -.5" stiffness="900" damping="25"/>' for i, axis in (("x", "1 0 0"), ("y", "0 1 0"))
)


def model_of(numbers: dict, step: float, case: str = "") -> str:
    """The lamp as MJCF; on a floor that gives where the case is `wobble`."""
    own = ("damping", "frictionloss", "armature")
    joints = {name: " ".join(f'{key}="{numbers[key][i]}"' for key in own) for i, name in enumerate(JOINTS)}
    servo = '<position name="{0}" joint="{0}" kp="{1}" kv="{2}" forcerange="-12 12"/>'
    servos = "".join(servo.format(name, numbers["kp"][i], numbers["kv"][i]) for i, name in enumerate(JOINTS))
    floor, mass = (SHAKY, 15) if case == "wobble" else ("", 1)
    return LAMP.format(dt=step, floor=floor, base_mass=mass, servos=servos, **joints)


@dataclass(eq=False)
class World:
    """One motion under way: the model as it is now and as it was, its state, the command [rad], what the hidden thing remembers."""

    model: mujoco.MjModel
    true: mujoco.MjModel
    data: mujoco.MjData
    phase: float
    command: np.ndarray = field(default_factory=lambda: np.zeros(3))
    memory: float = 0.0

    def __post_init__(self) -> None:
        self.at = [self.model.joint(name).qposadr[0] for name in JOINTS]
        self.before = self.data.qvel.copy()

    @property
    def q(self) -> np.ndarray:
        return self.data.qpos[self.at]

    @property
    def v(self) -> np.ndarray:
        return self.data.qvel[self.at]

    def push(self, joint: int, torque: float) -> None:
        """Put a torque [N m] on a joint for this step."""
        self.data.qfrc_applied[self.at[joint]] = torque


def hum(w: World) -> None:
    """Something swings in time, in step with the recording."""
    w.push(0, 0.6 * np.sin(6.2832 * 0.8 * w.data.time))


def wind(w: World) -> None:
    """The same, in another phase each time."""
    w.push(0, 0.6 * np.sin(6.2832 * 0.8 * w.data.time + w.phase))


def dropped(w: World) -> None:
    """A weight of 0.3 kg falls off after five seconds."""
    w.model.body("tool").mass[:] = w.true.body("tool").mass + (0.3 if w.data.time < 5 else 0.0)


def sag(w: World) -> None:
    """The supply gives less the more all servos take."""
    w.memory += (float(np.abs(w.data.qfrc_actuator).sum()) - w.memory) * STEP / 0.05
    left = 1 - 0.05 * w.memory
    w.model.actuator_gainprm[:], w.model.actuator_biasprm[:] = w.true.actuator_gainprm * left, w.true.actuator_biasprm * left


def cable(w: World) -> None:
    """A cable is dragged along, hysteresis over 0.2 rad."""
    w.memory += STEP * w.v[1] * (1 - 0.5 * (1 + np.sign(w.v[1] * w.memory)) * abs(w.memory / 0.2))
    w.push(1, -3.5 * w.memory)


def warm(w: World) -> None:
    """Dry friction melts as the joint moves."""
    w.memory += STEP * (abs(w.v[1]) * 1.0 - w.memory / 6)
    w.model.dof_frictionloss[w.at[1]] = 0.1 + 0.5 * np.exp(-2.5 * w.memory)


def harness(w: World) -> None:
    """The elbow's friction grows as the shoulder leans forward."""
    w.push(2, -0.35 * np.tanh(w.v[2] / 0.01) * max(0.0, w.q[1]))


def coarse(w: World) -> None:
    """Commands arrive in steps of 0.03 rad."""
    w.command = np.round(w.command / 0.03) * 0.03


def bumper(w: World) -> None:
    """A soft stop from 0.35 rad on."""
    w.push(1, -25 * max(0.0, w.q[1] - 0.35))


def accel(w: World) -> None:
    """The elbow feels how the shoulder speeds up."""
    w.push(2, -0.03 * (w.v[1] - w.before[w.at[1]]) / STEP)
    w.before = w.data.qvel.copy()


def dither(w: World) -> None:
    """Something pushes to and fro every second."""
    w.push(1, 0.5 * np.sign(np.sin(6.2832 * 0.5 * w.data.time)))


def oneway(w: World) -> None:
    """A damper that works one way, beyond one place."""
    w.push(2, -0.5 * max(0.0, w.v[2]) * (0.0 if w.q[2] < 0.1 else 1.0))


def starts(w: World) -> None:
    """A torque that dies away after each start."""
    w.push(1, 0.9 * np.exp(-w.data.time / 1.5))


def wobble(w: World) -> None:
    """The floor gives: in the model itself."""


CASES: dict[str, Callable[[World], None]] = {
    one.__name__: one
    for one in (hum, wind, dropped, sag, cable, warm, harness, coarse, bumper, accel, dither, oneway, starts, wobble)
}


def commands(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Times [s], (T,), and commands [rad], (T, 3), of one of four kinds: swings, straight lines, steps with a ramp, a chirp."""
    rows = int(SECONDS / PERIOD)
    t, u, kind = np.arange(rows) * PERIOD, np.zeros((rows, 3)), rng.integers(4)
    for j in range(3):
        if kind == 0:
            x = sum(rng.uniform(0.2, 1) * np.sin(6.2832 * f * t + rng.uniform(0, 6)) for f in rng.uniform(0.05, 0.9, 3)) / 2.4
        elif kind == 1:
            knots = rng.uniform(-1, 1, int(SECONDS) + 2)
            x = np.interp(t, np.arange(len(knots)), knots)
        elif kind == 2:
            levels = rng.uniform(-1, 1, int(SECONDS / 1.5) + 2)[(t // 1.5).astype(int)]
            x = levels.copy()
            for i in range(1, rows):
                x[i] = x[i - 1] + np.clip(levels[i] - x[i - 1], -0.05, 0.05)
        else:
            last = rng.uniform(0.8, 1.5)
            x = 0.5 * np.sin(6.2832 * (0.05 * t + (last - 0.05) * t**2 / 2 / SECONDS) + rng.uniform(0, 6))
        u[:, j] = REACH[j] * np.clip(x, -1, 1) * np.minimum(1, t)
    return t, u


def record(model: mujoco.MjModel, true: mujoco.MjModel, case: str, rng: np.random.Generator) -> np.ndarray:
    """One motion, rows of time [s], three commands and three measured angles [rad], (T, 7)."""
    t, u = commands(rng)
    data = mujoco.MjData(model)
    for _ in range(SETTLING):
        data.ctrl[:] = u[0]
        mujoco.mj_step(model, data)
    data.time = 0
    world, rows = World(model, true, data, rng.uniform(0, 6.28)), []
    for now, told in zip(t, u, strict=True):
        rows.append(np.concatenate([[now], told, world.q + NOISE * rng.normal(size=3)]))
        for _ in range(round(PERIOD / STEP)):
            world.command = told.copy()
            data.qfrc_applied[:] = 0.0
            CASES[case](world)
            data.ctrl[:] = world.command
            mujoco.mj_step(model, data)
    return np.array(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("case", choices=CASES)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    (asked.out / "data").mkdir(parents=True, exist_ok=True)
    (asked.out / "robot.xml").write_text(model_of(PUBLISHED, 0.002))
    model, true = (mujoco.MjModel.from_xml_string(model_of(TRUE, STEP, asked.case)) for _ in range(2))
    for i in range(MOTIONS):
        rng = np.random.default_rng(zlib.crc32(asked.case.encode()) % 9999 * 100 + asked.seed * 1000 + i)
        rows = record(model, true, asked.case, rng)
        write_motion(asked.out / "data", i, JOINTS, rows)


if __name__ == "__main__":
    main()
