"""Open-loop replay of one robot with its hook file: as a batch where the hook knows batches, else in a plain loop."""

import importlib.util
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.effect import MEASURED_SUFFIX, MOTOR_SUFFIX, joint_index
from edream.core.errors import EdreamError
from edream.sim.followers import Followers
from edream.sim.robot import RobotModel
from edream.sim.rollout import rollout
from edream.sim.servo import geared_readings
from edream.sim.simulation import SimulatedRobot
from edream.sim.start import start_velocity
from edream.sim.window import Window

Step = Callable[[mujoco.MjModel, mujoco.MjData], None]


def load_hook(path: Path) -> ModuleType:
    """The hook file a user named, and no other.

    Raises:
        EdreamError: there is no such file, it cannot be imported, or it has no `make`.
    """
    found = importlib.util.spec_from_file_location(f"hook_{path.stem}", path) if path.suffix == ".py" and path.is_file() else None
    if found is None or found.loader is None:
        raise EdreamError(f"There is no hook at {path}; expected a Python file with make(model) returning step(model, data).")
    module = importlib.util.module_from_spec(found)
    keep, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        found.loader.exec_module(module)
    except Exception as error:
        raise EdreamError(f"Hook {path} cannot be imported: {type(error).__name__}: {error}.") from error
    finally:
        sys.dont_write_bytecode = keep
    if not callable(getattr(module, "make", None)):
        raise EdreamError(f"Hook {path} has no function make; expected make(model) returning step(model, data).")
    return module


def open_loop(
    robot: RobotModel,
    windows: Sequence[Window],
    hook: Path | None = None,
    threads: int = 0,
    scaled: SimulatedRobot | None = None,
) -> list[Float[np.ndarray, "T J"]]:
    """Replay each window's commands, with the robot's hook file where it has one; positions at the measured times [rad or m].

    Args:
        robot: the robot.
        windows: stretches to replay.
        hook: its hook file.
        threads: simulation threads; 0 for every core.
        scaled: the robot with what the recordings' conditions multiply, where they do.

    Raises:
        EdreamError: the hook cannot be loaded, or it knows no batches where conditions scale a parameter.
    """
    module = None if hook is None else load_hook(hook)
    if module is not None and not hasattr(module, "make_batch"):
        if scaled:
            raise EdreamError(f"Hook {hook} has no make_batch, which robot.scaled needs; hooks that edream writes have one.")
        return [plain_loop(robot, module.make, window) for window in windows]
    many = None if module is None else module.make_batch
    return [one[0] for one in rollout(scaled or SimulatedRobot(robot, ()), np.zeros((1, 0)), windows, threads, many)]


def plain_loop(robot: RobotModel, make: Callable[[mujoco.MjModel], Step], window: Window) -> Float[np.ndarray, "T J"]:
    """One motion in a plain MuJoCo loop, for hooks that know no batches; NaN from where the simulation blew up."""
    model = robot.spec().compile()
    data, episode, joints = mujoco.MjData(model), window.episode, window.episode.joints
    index = [joint_index(model, joint) for joint in joints]
    _start(model, data, window, index)
    step = make(model)
    gains = model.actuator_gainprm.copy(), model.actuator_biasprm.copy()
    driven = model.actuator_ctrlnum > 0
    dt, begin = float(model.opt.timestep), float(episode.times[window.first])
    sensed = all(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, joint + MEASURED_SUFFIX) >= 0 for joint in joints)
    qpos = [one["qpos"] for one in index]
    grid = [data.qpos[qpos].copy()]
    for k in range(int(np.ceil(window.times[-1] / dt)) + int(sensed)):
        row = max(0, int(np.searchsorted(episode.command_times, begin + k * dt + 1e-9, side="right")) - 1)
        on = episode.enabled is None or bool(episode.enabled[row])
        model.actuator_gainprm[driven] = gains[0][driven] * on
        model.actuator_biasprm[driven] = gains[1][driven] * on
        data.ctrl[[one["ctrl"] for one in index]] = episode.command[row]
        step(model, data)
        mujoco.mj_step(model, data)
        if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number or not np.isfinite(data.qpos).all():
            grid[1:] = [np.full(len(joints), np.nan)] * len(grid[1:])
            grid += [np.full(len(joints), np.nan)]
            break
        now = [data.sensor(joint + MEASURED_SUFFIX).data[0] for joint in joints] if sensed else data.qpos[qpos]
        grid.append(np.array(now))
    grid = grid[1:] if sensed else grid  # a sensor describes the state before the step it is read after
    clock = dt * np.arange(len(grid))
    out = np.stack([np.interp(window.times, clock, np.array(grid)[:, j]) for j in range(len(joints))], axis=1)
    return np.concatenate([window.measured[:1], out[1:]])


def _start(model: mujoco.MjModel, data: mujoco.MjData, window: Window, index: Sequence[Mapping[str, int]]) -> None:
    geared = geared_readings(model, window.episode.joints)
    for joint, one, reading, rate in zip(window.episode.joints, index, window.measured[0], start_velocity(window), strict=True):
        gear = float(model.actuator_gear[geared[joint], 0]) if joint in geared else 1.0
        position, speed = reading / gear, rate / gear
        data.qpos[one["qpos"]], data.qvel[one["dof"]] = position, speed
        twin = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint + MOTOR_SUFFIX)
        if twin >= 0:
            data.qpos[model.jnt_qposadr[twin]], data.qvel[model.jnt_dofadr[twin]] = position, speed
    Followers(model, window.episode.joints).place(data.qpos, data.qvel)
