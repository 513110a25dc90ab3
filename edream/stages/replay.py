"""Replay: how far any MJCF is from any recordings when it is given their commands, open loop."""

import importlib.util
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from edream.calibration.errors import perfect_tracking, summary
from edream.calibration.settings import RobotSettings
from edream.core.effect import MEASURED_SUFFIX, MOTOR_SUFFIX, joint_index
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.stored import stored_episodes
from edream.sim.robot import RobotModel
from edream.sim.rollout import Window, rollout, start_velocity, whole
from edream.sim.simulation import SimulatedRobot

UNSTABLE = 10.0  # rad; what a simulation that blew up counts as
Step = Callable[[mujoco.MjModel, mujoco.MjData], None]


@dataclass(frozen=True)
class ReplayOptions:
    """What is scored; see `conf/replay/default.yaml` for each."""

    joints: tuple[str, ...] = ()
    until: float | None = None
    hook: Path | None = None


@dataclass(frozen=True)
class ReplayConfig:
    """What replay reads."""

    robot: RobotSettings
    replay: ReplayOptions


def sources(config: ReplayConfig) -> Mapping[str, Source]:
    """The model with all its files, and the hook."""
    return {"robot": config.robot.content()} | ({"hook": config.replay.hook} if config.replay.hook else {})


def run(inputs: Mapping[str, Artifact], config: ReplayConfig, work: Work) -> Bundle:
    """Replay every recording and score it."""
    options = config.replay
    episodes = list(stored_episodes(inputs["ingest"]))
    found = replay(config.robot.load(), episodes, options.joints, options.until, options.hook)
    count = f"{len(episodes)} motions" if len(episodes) != 1 else "1 motion"
    sentence = (
        f"Open-loop replay of {count}: {found['rmse_rad']:.4g} rad; a robot that tracked perfectly would score "
        f"{found['perfect_tracking_rmse_rad']:.4g} rad."
    )
    return {"summary.json": {"sentence": sentence, **found}}


def replay(
    robot: RobotModel,
    episodes: Sequence[Episode],
    joints: Sequence[str] = (),
    until: float | None = None,
    hook: Path | None = None,
    threads: int = 0,
) -> dict[str, Any]:
    """Open-loop replay errors of a robot on recordings, each from its first measured state.

    Args:
        joints: joints that count in what is summed over joints; all where empty.
        until: seconds of each motion that are scored.
        hook: Python file with `make(model)` returning `step(model, data)`, and where it has one, `make_batch(batch)`. It is code:
            it runs with all your rights. Neither configs nor recordings can name one without you.
        threads: simulation threads; 0 for every core.

    Returns:
        `rmse_rad`, `mae_rad`, `translation_m`, `rotation_rad` (end effector, root mean square), `perfect_tracking_rmse_rad`;
        `per_joint` and `per_episode` with `rmse_rad` and `mae_rad` each; `unstable`: motions on which the simulation blew up.

    Raises:
        EdreamError: a joint is unknown, there is nothing to score, or the hook cannot be loaded.
    """
    counted = np.zeros(len(robot.joints), dtype=bool)
    counted[[robot.joint_index(name) for name in joints] if joints else slice(None)] = True
    if until is not None and until <= 0.0:
        raise EdreamError(f"replay.until is {until:g} s; expected a time above 0.")
    windows = whole(episodes, until)
    positions = _simulated(robot, windows, hook, threads)
    simulated = SimulatedRobot(robot, ())
    table = summary(simulated, positions, windows, counted)
    perfect = perfect_tracking(simulated, episodes, counted, until)
    errors = [np.nan_to_num(p[1:] - w.measured[1:], nan=UNSTABLE) for p, w in zip(positions, windows, strict=True)]
    every = np.concatenate(errors)
    return {
        **_scores(every[:, counted]),
        "translation_m": table["translation_m"],
        "rotation_rad": table["rotation_rad"],
        "perfect_tracking_rmse_rad": perfect["joint_rmse_rad"],
        "per_joint": {name: _scores(every[:, i]) for i, name in enumerate(robot.joints)},
        "per_episode": {w.episode.name: _scores(e[:, counted]) for w, e in zip(windows, errors, strict=True)},
        "joints": [name for name, count in zip(robot.joints, counted, strict=True) if count],
        "unstable": [w.episode.name for w, p in zip(windows, positions, strict=True) if not np.isfinite(p).all()],
    }


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


def _simulated(robot: RobotModel, windows: Sequence[Window], hook: Path | None, threads: int) -> list[Float[np.ndarray, "T J"]]:
    module = None if hook is None else load_hook(hook)
    if module is not None and not hasattr(module, "make_batch"):
        return [plain_loop(robot, module.make, window) for window in windows]
    many = None if module is None else module.make_batch
    return [one[0] for one in rollout(SimulatedRobot(robot, ()), np.zeros((1, 0)), windows, threads, many)]


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
    for joint, one, position, speed in zip(window.episode.joints, index, window.measured[0], start_velocity(window), strict=True):
        data.qpos[one["qpos"]], data.qvel[one["dof"]] = position, speed
        twin = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint + MOTOR_SUFFIX)
        if twin >= 0:
            data.qpos[model.jnt_qposadr[twin]], data.qvel[model.jnt_dofadr[twin]] = position, speed


def _scores(errors: np.ndarray) -> dict[str, float]:
    return {"rmse_rad": float(np.sqrt(np.mean(np.square(errors)))), "mae_rad": float(np.mean(np.abs(errors)))}


ENTRY = Stage("replay", 1, ("ingest",), ReplayConfig, run, sources, ("mujoco", "numpy"))
