"""Recordings of any published arm as an outsider makes them: plain MuJoCo, its own soft dry friction, one thing hidden.

python -m benchmarks.plain_mujoco MODEL.xml OUT [--hide load:joint_2:0.15] [--seed 2] [--friction 2.5] [--armature 0.15]

What is hidden is a torque on a joint, a number of the model that is no usual one, or what becomes of a joint's commands on their way.

Gains, dampings, frictions and rotors are 25 % below to 30 % above what the model says, or what `--friction` [N m] and `--armature`
[kg m^2] say of the strongest servo where it has none; 0.2 mrad of noise. OUT gets `data`, one CSV a motion, and `truth.txt`. Then:
edream diagnose robot.mjcf=MODEL.xml data=OUT/data
"""

import argparse
import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np

STEP, PERIOD, SECONDS, SETTLING = 0.0005, 0.02, 10.0, 4000  # s, s, s, steps
NOISE = 2e-4  # rad
Law = Callable[[mujoco.MjData, int, int], float]  # the torque [N m] on a joint, by its places among positions and speeds


def sign(speed: float) -> float:
    return float(np.tanh(speed / 0.004))


EFFECTS: dict[str, Callable[..., Law]] = {
    # numbers: share of the servo's torque
    "load": lambda share: lambda d, q, v: -share * abs(d.qfrc_actuator[v]) * sign(d.qvel[v]),
    # torque [N m] above the dry friction at rest, speed [rad/s]
    "stribeck": lambda top, speed: lambda d, q, v: -top * np.exp(-((d.qvel[v] / speed) ** 2)) * sign(d.qvel[v]),
    # stiffness [N m/rad], angle at rest [rad]
    "spring": lambda stiffness, rest: lambda d, q, v: -stiffness * (d.qpos[q] - rest),
    # torque at 1 rad/s [N m s^2/rad^2]
    "drag": lambda size: lambda d, q, v: -size * d.qvel[v] * abs(d.qvel[v]),
    # amplitude [N m], periods a turn
    "cogging": lambda size, count: lambda d, q, v: size * np.sin(count * d.qpos[q] + 0.7),
    # amplitude [N m], frequency [Hz]
    "wind": lambda size, hertz: lambda d, q, v: size * np.sin(6.2832 * hertz * d.time),
}

CHANGES: dict[str, Callable[..., None]] = {
    # mass [kg] more on the body that the joint moves
    "payload": lambda model, joint, mass: _add(model.body_mass, model.jnt_bodyid[joint], mass),
    # torque [N m] that the joint's servo gives at most
    "limit": lambda model, joint, torque: _limit(model, joint, torque),
    # angle [rad] by which the base leans about its x axis, whichever joint is named
    "tilt": lambda model, joint, angle: _lean(model, angle),
}
WAYS: dict[str, Callable[..., Callable[[np.ndarray], np.ndarray]]] = {
    # seconds by which commands come late
    "delay": lambda seconds: lambda u: u[np.maximum(np.arange(len(u)) - round(seconds / STEP), 0)],
    # speed [rad/s] at which a setpoint moves at most
    "slew": lambda speed: lambda u: _followed(u, lambda gap: np.clip(gap, -speed * STEP, speed * STEP)),
    # time constant [s] of a low pass
    "lag": lambda seconds: lambda u: _followed(u, lambda gap: gap * STEP / (seconds + STEP)),
}


def _add(numbers: np.ndarray, place: int, more: float) -> None:
    numbers[place] += more


def _servo(model: mujoco.MjModel, joint: int) -> int:
    """The number of the servo that drives a joint; ValueError where none does."""
    servos = np.flatnonzero(model.actuator_trnid[:, 0] == joint)
    if not len(servos):
        raise ValueError(f"no servo drives {model.joint(joint).name}; expected one of a joint that is driven")
    return int(servos[0])


def _limit(model: mujoco.MjModel, joint: int, torque: float) -> None:
    servo = _servo(model, joint)
    model.actuator_forcelimited[servo], model.actuator_forcerange[servo] = 1, (-torque, torque)


def _lean(model: mujoco.MjModel, angle: float) -> None:
    size = -model.opt.gravity[2]
    model.opt.gravity[:] = 0.0, size * np.sin(angle), -size * np.cos(angle)


def _followed(u: np.ndarray, move: Callable[[float], float]) -> np.ndarray:
    out = u.copy()
    for i in range(1, len(u)):
        out[i] = out[i - 1] + move(u[i] - out[i - 1])
    return out


def changed(model: mujoco.MjModel, rng: np.random.Generator, friction: float, armature: float) -> list[str]:
    """Change the usual numbers of every servo and its joint; says what is true now."""
    strength, told = model.actuator_gainprm[:, 0] / model.actuator_gainprm[:, 0].max(), []
    for a in range(model.nu):
        joint = model.joint(model.actuator_trnid[a, 0])
        v, share = joint.dofadr[0], max(strength[a], 0.2)
        model.dof_damping[v] *= rng.uniform(0.75, 1.3)
        for numbers, added in ((model.dof_frictionloss, friction), (model.dof_armature, armature)):
            numbers[v] = (numbers[v] or added * share) * rng.uniform(0.75, 1.3)
        gain, damping = rng.uniform(0.75, 1.3), rng.uniform(0.75, 1.3)
        model.actuator_gainprm[a, 0] *= gain
        model.actuator_biasprm[a, 1] *= gain
        model.actuator_biasprm[a, 2] *= damping
        numbers = (model.actuator_gainprm[a, 0], -model.actuator_biasprm[a, 2], model.dof_damping[v])
        words = zip(
            ("kp", "kv", "damping", "friction", "armature"),
            (*numbers, model.dof_frictionloss[v], model.dof_armature[v]),
            strict=True,
        )
        told.append(joint.name + "".join(f" {word} {value:.6g}" for word, value in words))
    mujoco.mj_setConst(model, mujoco.MjData(model))  # how soft friction is goes by the inertia that a joint moves
    return told


def commands(rng: np.random.Generator, home: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times [s], (T,), and commands [rad], (T, J), of one of three kinds: swings, straight lines, steps with a ramp."""
    rows = int(SECONDS / PERIOD)
    t, u, kind = np.arange(rows) * PERIOD, np.zeros((rows, len(home))), rng.integers(3)
    for j in range(len(home)):
        if kind == 0:
            x = sum(rng.uniform(0.2, 1) * np.sin(6.2832 * f * t + rng.uniform(0, 6)) for f in rng.uniform(0.05, 0.6, 3)) / 2
        elif kind == 1:
            knots = rng.uniform(-1, 1, int(SECONDS / 1.2) + 3)
            x = np.interp(t, np.arange(len(knots)) * 1.2, knots)
        else:
            levels = rng.uniform(-1, 1, int(SECONDS / 2) + 2)[(t // 2).astype(int)]
            x = levels.copy()
            for i in range(1, rows):
                x[i] = x[i - 1] + np.clip(levels[i] - x[i - 1], -0.03, 0.03)
        u[:, j] = home[j] + reach[j] * np.clip(x, -1, 1) * np.minimum(1, t)
    return t, u


def hidden(model: mujoco.MjModel, told: str) -> tuple[Callable[[mujoco.MjData], None], Callable[[np.ndarray], np.ndarray]]:
    """What puts a hidden torque on its joint before each step, and what becomes of commands on their way, (steps, J).

    Another model is changed in place. ValueError where `told` is no EFFECT:JOINT:NUMBERS of the model.
    """
    effect, name, *numbers = told.split(":") if ":" in told else (told, "")
    joints, known = [model.joint(i).name for i in range(model.njnt)], EFFECTS | CHANGES | WAYS
    if effect not in known or name not in joints:
        raise ValueError(f"expected EFFECT:JOINT:NUMBERS, of {', '.join(known)} and of {', '.join(joints)}")
    if len(numbers) != (count := known[effect].__code__.co_argcount - 2 * (effect in CHANGES)):
        raise ValueError(f"{len(numbers)} numbers; {effect} takes {count}")
    joint, values = model.joint(name), [float(number) for number in numbers]
    q, v = joint.qposadr[0], joint.dofadr[0]
    law = EFFECTS[effect](*values) if effect in EFFECTS else lambda d, q, v: 0.0
    if effect in CHANGES:
        CHANGES[effect](model, joint.id, *values)

    def push(data: mujoco.MjData) -> None:
        data.qfrc_applied[v] = law(data, q, v)

    if effect not in WAYS:
        return push, lambda u: u
    servo = _servo(model, joint.id)

    def way(u: np.ndarray) -> np.ndarray:
        out = u.copy()
        out[:, servo] = WAYS[effect](*values)(u[:, servo])
        return out

    return push, way


def room(model: mujoco.MjModel, joints: list, places: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Where motions begin, inside the joints' ranges, and how far they go from there [rad], (J,) each."""
    low, high = np.array([one.range if model.jnt_limited[one.id] else (-3, 3) for one in joints]).T
    home = model.key_qpos[0][places] if model.nkey else np.zeros(model.nu)
    home = np.clip(home, low + 0.15 * (high - low), high - 0.15 * (high - low))
    return home, np.minimum(0.9, 0.85 * np.minimum(home - low, high - home))


def played(
    model: mujoco.MjModel,
    places: list[int],
    u: np.ndarray,
    rng: np.random.Generator,
    push: Callable[[mujoco.MjData], None],
    way: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Measured angles [rad] just before each command is given, (T, J)."""
    data, rows, each = mujoco.MjData(model), [], round(PERIOD / STEP)
    data.qpos[places], data.ctrl[:] = u[0], u[0]
    for _ in range(SETTLING):
        mujoco.mj_step(model, data)
    data.time = 0
    for step, command in enumerate(way(np.repeat(u, each, axis=0))):
        if step % each == 0:
            rows.append(data.qpos[places] + NOISE * rng.normal(size=model.nu))
        data.ctrl[:] = command
        push(data)
        mujoco.mj_step(model, data)
    return np.array(rows)


def write_motion(folder: Path, number: int, joints: Sequence[str], rows: np.ndarray) -> None:
    """One motion as CSV: time [s], a command and a measured angle [rad] of each joint, (T, 1 + 2 J)."""
    with (folder / f"motion_{number:02d}.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["time", *(f"command_{name}" for name in joints), *(f"position_{name}" for name in joints)])
        table.writerows([[f"{value:.9g}" for value in row] for row in rows])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--hide", help=f"EFFECT:JOINT:NUMBERS, of {', '.join(EFFECTS | CHANGES | WAYS)}")
    for name, kind, default in (("seed", int, 1), ("motions", int, 12), ("friction", float, 0.0), ("armature", float, 0.0)):
        parser.add_argument(f"--{name}", type=kind, default=default)
    asked = parser.parse_args()
    model = mujoco.MjModel.from_xml_path(str(asked.model))
    if other := [model.actuator(a).name for a in range(model.nu) if model.actuator_trntype[a] != mujoco.mjtTrn.mjTRN_JOINT]:
        parser.error(f"{asked.model}: {', '.join(other)} drive no joint; expected a servo for each joint, take others out")
    try:
        push, way = hidden(model, asked.hide) if asked.hide else (lambda data: None, lambda u: u)
    except ValueError as error:
        parser.error(f"--hide {asked.hide}: {error}")
    model.opt.timestep = STEP
    told = changed(model, np.random.default_rng(asked.seed), asked.friction, asked.armature)
    joints = [model.joint(model.actuator_trnid[a, 0]) for a in range(model.nu)]
    places = [int(one.qposadr[0]) for one in joints]
    home, reach = room(model, joints, places)
    (asked.out / "data").mkdir(parents=True, exist_ok=True)
    (asked.out / "truth.txt").write_text("\n".join([*told, f"hidden: {asked.hide}"]) + "\n")
    for i in range(asked.motions):
        rng = np.random.default_rng(asked.seed * 1000 + i)
        t, u = commands(rng, home, reach)
        rows = np.column_stack([t, u, played(model, places, u, rng, push, way)])
        write_motion(asked.out / "data", i, [one.name for one in joints], rows)


if __name__ == "__main__":
    main()
