"""Diagnose: find where simulation and measurement disagree, name what is missing, add it, show that the gap shrinks."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from edream.calibration.gripping import gripping
from edream.calibration.settings import Limits, RobotSettings, ScaledBy, counting, scalings
from edream.core.effect import holds_position
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.diagnosis.evidence import evidence
from edream.diagnosis.next_motion import Motion, suggest
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.set_up import how_to_record
from edream.diagnosis.verdict import Diagnosis, diagnose
from edream.ingest.causality import beware
from edream.ingest.episode_file import write_commands
from edream.ingest.stored import stored_episodes
from edream.sim.emit import emit
from edream.sim.robot import RobotModel

HOOK = "hook.py"
CONDITIONS = "next_motion.json"  # what to set, and to note, each time that the next motion is recorded


@dataclass(frozen=True)
class DiagnoseOptions:
    """What to look for and how to judge; see `conf/diagnose/default.yaml` for each."""

    nuisance: tuple[str, ...]
    ties: tuple[tuple[str, ...], ...] = ()
    scaled: Mapping[str, ScaledBy] = field(default_factory=dict)
    limits: Mapping[str, Limits] = field(default_factory=dict)
    effects: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    grips: tuple[str, ...] = ()
    until: float | None = None
    seconds: float = 160.0
    proof: float = 0.25
    holdout: tuple[str, ...] = ()
    stride: int = 1
    model_floor: float = 1.5e-4
    gain: float = 0.1
    most: int = 4
    next_motion: bool = True


@dataclass(frozen=True)
class DiagnoseConfig:
    """What diagnose reads."""

    robot: RobotSettings
    diagnose: DiagnoseOptions
    seed: int


def sources(config: DiagnoseConfig) -> Mapping[str, Source]:
    """The robot's model with all its files."""
    return {"robot": config.robot.content()}


def run(inputs: Mapping[str, Artifact], config: DiagnoseConfig, work: Work) -> Bundle:
    """Diagnose the ingested motions against the robot's model."""
    published = config.robot.load()
    episodes = list(stored_episodes(inputs["ingest"]))
    problem = prepare(published, episodes, settings_of(config, published))
    proof = {window.episode.name for window in problem.proof}
    grip = gripping(problem.robot, config.diagnose.grips, [one for one in episodes if one.name not in proof])
    problem = replace(problem, robot=grip.robot)
    with work.progress(None, "diagnosing") as bar:
        found = diagnose(problem, lambda text, n: bar.update(n))
    made = emit(found.after.objective.simulated, found.after.values, beside=published)
    bundle: dict[str, Any] = {**evidence(found), "model.xml": made.mjcf, **made.files, "difference.txt": made.difference}
    if made.hook:
        bundle[HOOK] = made.hook
    doubted = config.diagnose.next_motion and len(found.contenders) > 1
    if doubted:
        motion = suggest(found.problem, [fit for _, fit in found.contenders], work.rng)
        bundle |= motion_files(motion, work) if motion is not None else {}
    more = advice(found, bundle) if doubted else ""
    told = summary(found, bundle, more + beware(episodes))
    return bundle | {"summary.json": told | ({"grips": grip.joints} if grip.joints else {})}


def motion_files(motion: Motion, work: Work) -> Bundle:
    """The motion to record next: a table (time [s], a column [rad] a joint) and the same as MCAP."""
    path = work.folder("next_motion") / "next_motion.mcap"
    write_commands(motion.joints, motion.times, motion.command, path)
    return {"next_motion.csv": motion.table(), "next_motion.mcap": path, CONDITIONS: [dict(one) for one in motion.conditions]}


def settings_of(config: DiagnoseConfig, robot: RobotModel) -> Settings:
    """The diagnosis' own settings from the config."""
    options = {
        key: value for key, value in vars(config.diagnose).items() if key not in ("next_motion", "scaled", "limits", "grips")
    }
    options["joints"] = counting(robot, config.diagnose.joints, config.diagnose.grips)
    limits = {name: {k: v for k, v in vars(one).items() if v is not None} for name, one in config.diagnose.limits.items()}
    return Settings(**options, scaled=scalings(config.diagnose.scaled), limits=limits, seed=config.seed)


def advice(found: Diagnosis, bundle: Mapping[str, Any]) -> str:
    """What to do about a doubt, for which a motion was looked for."""
    if "next_motion.csv" in bundle:
        return f" {how_to_record(bundle[CONDITIONS])}"
    held = all(holds_position(found.problem.robot.model, joint) for joint in found.problem.joints)
    return " No motion of the joints was found that would tell." if held else " Motions are suggested for position servos alone."


def summary(found: Diagnosis, bundle: Mapping[str, Any], more: str) -> dict[str, Any]:
    """The result as one object; file names stand for their paths, and `more` is said after the sentence."""
    problem = found.problem
    return {
        "sentence": f"{found.sentence}{more}",
        "verdict": found.verdict,
        "effects": [
            {
                "name": one.name,
                "targets": list(one.targets),
                "values": dict(one.values),
                "intervals": {name: list(pair) for name, pair in one.intervals.items()},
                "units": dict(one.units),
                "closed": None if one.closed != one.closed else one.closed,
                "runner_up": None if one.runner_up is None else {"candidate": one.runner_up[0], "closed": one.runner_up[1]},
                "confusable_with": list(one.confusable_with),
                "motion": one.motion,
            }
            for one in found.effects
        ],
        "gap": {
            "published_rad": found.published_rms,
            "before_rad": found.before_rms,
            "after_rad": found.after_rms,
            "noise_floor_rad": problem.noise_floor,
        },
        "unstable": list(found.unstable),
        "step_s": {
            "published": float(problem.robot.published.model.opt.timestep),
            "searched": float(found.searched.model.opt.timestep),
            "used": float(problem.robot.model.opt.timestep),
        },
        "formula": None if found.remainder is None else found.remainder.formula,
        "parameters": found.after.space.mapping(found.after.values),
        "motions": {
            "fitted": [window.episode.name for window in problem.fitted],
            "proof": [window.episode.name for window in problem.proof],
        }
        | ({"set_aside": list(found.aside)} if found.aside else {}),
        "model": "model.xml",
        "hook": HOOK if HOOK in bundle else None,
        "next_motion": "next_motion.csv" if "next_motion.csv" in bundle else None,
        "next_motion_conditions": bundle.get(CONDITIONS, []),
    }


ENTRY = Stage("diagnose", 180, ("ingest",), DiagnoseConfig, run, sources, ("mujoco", "numpy", "scipy"))
