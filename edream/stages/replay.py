"""Replay: how far any MJCF is from any recordings when it is given their commands, open loop."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from edream import catalog
from edream.calibration.errors import perfect_tracking, summary
from edream.calibration.pose import Chain
from edream.calibration.settings import RobotSettings, ScaledBy, scalings
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.core.errors import EdreamError, unknown_name
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.stored import stored_episodes
from edream.sim.open_loop import open_loop
from edream.sim.robot import RobotModel
from edream.sim.simulation import Placement, Scaling, SimulatedRobot
from edream.sim.window import whole

UNSTABLE = 10.0  # rad; what a simulation that blew up counts as


@dataclass(frozen=True)
class ReplayOptions:
    """What is scored; see `conf/replay/default.yaml` for each."""

    joints: tuple[str, ...] = ()
    until: float | None = None
    hook: Path | None = None


@dataclass(frozen=True)
class ReplayedRobot(RobotSettings):
    """The robot, and which of its numbers a recorded condition multiplies."""

    scaled: Mapping[str, ScaledBy] = field(default_factory=dict)


@dataclass(frozen=True)
class ReplayConfig:
    """What replay reads."""

    robot: ReplayedRobot
    replay: ReplayOptions


def sources(config: ReplayConfig) -> Mapping[str, Source]:
    """The model with all its files, and the hook."""
    return {"robot": config.robot.content()} | ({"hook": config.replay.hook} if config.replay.hook else {})


def run(inputs: Mapping[str, Artifact], config: ReplayConfig, work: Work) -> Bundle:
    """Replay every recording and score it."""
    options = config.replay
    episodes = list(stored_episodes(inputs["ingest"]))
    scaled = scalings(config.robot.scaled, episodes)
    found = replay(config.robot.load(), episodes, options.joints, options.until, options.hook, scaled=scaled)
    count = f"{len(episodes)} motions" if len(episodes) != 1 else "1 motion"
    perfect = found["perfect_tracking_rmse_rad"]
    beside = "" if perfect is None else f"; a robot that tracked perfectly would score {perfect:.4g} rad"
    sentence = f"Open-loop replay of {count}: {found['rmse_rad']:.4g} rad{beside}."
    return {"summary.json": {"sentence": sentence, **found}}


def replay(
    robot: RobotModel,
    episodes: Sequence[Episode],
    joints: Sequence[str] = (),
    until: float | None = None,
    hook: Path | None = None,
    threads: int = 0,
    scaled: Mapping[str, Scaling] | None = None,
) -> dict[str, Any]:
    """Open-loop replay errors of a robot on recordings, each from its first measured state.

    Args:
        joints: joints that count in what is summed over joints; all where empty.
        until: seconds of each motion that are scored.
        hook: Python file with `make(model)` returning `step(model, data)`, and where it has one, `make_batch(batch)`. It is code:
            it runs with all your rights. Neither configs nor recordings can name one without you.
        threads: simulation threads; 0 for every core.
        scaled: parameter "effect.quantity" -> the recorded condition that multiplies what the MJCF has.

    Returns:
        `rmse_rad`, `mae_rad`, `translation_m`, `rotation_rad` (end effector, root mean square); `perfect_tracking_rmse_rad`,
        None where commands are no positions; `end_effector`: the site or body that was taken for it; `per_joint` and
        `per_episode` with `rmse_rad` and `mae_rad` each; `unstable`: motions on which the simulation blew up.

    Raises:
        EdreamError: a joint is unknown, there is nothing to score, or the hook cannot be loaded.
    """
    counted = np.zeros(len(robot.joints), dtype=bool)
    counted[[robot.joint_index(name) for name in joints] if joints else slice(None)] = True
    if until is not None and until <= 0.0:
        raise EdreamError(f"replay.until is {until:g} s; expected a time above 0.")
    windows = whole(episodes, until)
    positions = open_loop(robot, windows, hook, threads, under_conditions(robot, scaled) if scaled else None)
    simulated = SimulatedRobot(robot, ())
    table = summary(simulated, positions, windows, counted)
    perfect = perfect_tracking(simulated, episodes, counted, until)
    errors = [np.nan_to_num(p[1:] - w.measured[1:], nan=UNSTABLE) for p, w in zip(positions, windows, strict=True)]
    every = np.concatenate(errors)
    return {
        **_scores(every[:, counted]),
        "translation_m": table["translation_m"],
        "rotation_rad": table["rotation_rad"],
        "perfect_tracking_rmse_rad": perfect["joint_rmse_rad"] if perfect else None,
        "per_joint": {name: _scores(every[:, i]) for i, name in enumerate(robot.joints)},
        "per_episode": {w.episode.name: _scores(e[:, counted]) for w, e in zip(windows, errors, strict=True)},
        "end_effector": Chain(robot).end,
        "joints": [name for name, count in zip(robot.joints, counted, strict=True) if count],
        "unstable": [w.episode.name for w, p in zip(windows, positions, strict=True) if not np.isfinite(p).all()],
    }


def under_conditions(robot: RobotModel, scaled: Mapping[str, Scaling]) -> SimulatedRobot:
    """The robot as its MJCF has it, with numbers such as `servo_gain.kp` multiplied by what is known of each recording.

    Raises:
        EdreamError: there is no such effect or quantity.
    """
    placements = []
    for name in dict.fromkeys(key.partition(".")[0] for key in scaled):
        effect = catalog.load("effects", name, Effect)
        own = {key.partition(".")[2]: scaling for key, scaling in scaled.items() if key.partition(".")[0] == name}
        met: set[str] = set()
        for joint in robot.joints:  # a motor beside position servos has no kp
            start = {parameter.name: parameter.start for parameter in effect.parameters(robot.model, (joint,))}
            here = {quantity: scaling for quantity, scaling in own.items() if quantity in start}
            met |= set(start)
            if here:
                placements.append(Placement(effect, (joint,), scaled=here, fixed=start))
        for quantity in own:
            if quantity not in met:
                raise unknown_name(f"quantity of {name} for robot.scaled", quantity, met)
    return SimulatedRobot(robot, tuple(placements))


def _scores(errors: np.ndarray) -> dict[str, float]:
    return {"rmse_rad": float(np.sqrt(np.mean(np.square(errors)))), "mae_rad": float(np.mean(np.abs(errors)))}


ENTRY = Stage("replay", 8, ("ingest",), ReplayConfig, run, sources, ("mujoco", "numpy"))
