"""The evidence of a diagnosis as tables, for the report and for anyone who wants to look."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pyarrow as pa

from edream.core.parameters import Parameter
from edream.diagnosis.descent import Fit
from edream.diagnosis.problem import Problem
from edream.diagnosis.verdict import Diagnosis
from edream.sim.followers import Followers
from edream.sim.rollout import rollout
from edream.sim.servo import asked_positions
from edream.sim.simulation import SimulatedRobot
from edream.sim.window import Window


def evidence(found: Diagnosis) -> Mapping[str, Any]:
    """Tables by file name.

    `traces.parquet`: never-fitted motions, one row a (motion, joint, time): command (NaN where it is no position), measured,
    published, before, after [rad], speed [rad/s] and gravity load [N m]. `errors.json`: root-mean-square error by motion and
    joint, before and after, over all motions. `ladder.json`: error on never-fitted motions after each added effect.
    `ranking.json`: every round's candidates. `nuisance.json`: nuisance numbers published, before and after, with intervals.
    """
    problem = found.problem
    return {
        "traces.parquet": _traces(found),
        "errors.json": _errors(found),
        "ladder.json": [{"step": label, "motions_rad": [float(e) for e in errors]} for label, errors in found.ladder],
        "ranking.json": [_round(problem, one) for one in found.rounds],
        "nuisance.json": _nuisance(found),
    }


def _round(problem: Problem, one: Any) -> dict[str, Any]:
    return {
        "left_out_rad": float(np.sqrt(one.errors.mean())),
        "taken": one.taken.candidate.label if one.taken else None,
        "screened": [{"candidate": s.candidate.label, "share": s.share} for s in one.scored],
        "refitted": [
            {"candidate": t.candidate.label, "closed": t.closed, "sure": t.sure, "left_out_rad": float(np.sqrt(t.errors.mean()))}
            for t in one.trials
        ],
    }


def _positions(problem: Problem, simulated: SimulatedRobot, values: np.ndarray, windows: tuple[Window, ...]) -> list[np.ndarray]:
    return [one[0] for one in rollout(simulated, values[None], windows, problem.settings.threads)]


def _traces(found: Diagnosis) -> pa.Table:
    problem, windows = found.problem, found.problem.proof
    versions = {
        "published": _positions(problem, SimulatedRobot(problem.robot.published, ()), np.zeros(0), windows),
        "before": _positions(problem, found.before.objective.simulated, found.before.values, windows),
        "after": _positions(problem, found.after.objective.simulated, found.after.values, windows),
    }
    parts = []
    for number, window in enumerate(windows):
        episode, times = window.episode, window.times
        rows = episode.in_force(episode.times[window.first : window.last + 1])
        speed = np.gradient(window.measured, times, axis=0)
        load, asked = gravity_load(problem, window), asked_positions(problem.robot.model, episode.joints, episode.command[rows])
        for joint in problem.joints:
            j = episode.joints.index(joint)
            columns = {
                "motion": np.full(len(times), episode.name),
                "joint": np.full(len(times), joint),
                "time": times,
                "command": asked[:, j],
                "measured": window.measured[:, j],
                **{name: versions[name][number][:, j] for name in versions},
                "speed": speed[:, j],
                "load": load[:, j],
            }
            parts.append(pa.table(columns))
    return pa.concat_tables(parts)


def gravity_load(problem: Problem, window: Window) -> np.ndarray:
    """Torque [N m] that gravity puts on each recorded joint of the published model at the measured poses, (T, J)."""
    model = problem.robot.model
    data = mujoco.MjData(model)
    joints = window.episode.joints
    qpos = [int(model.jnt_qposadr[model.joint(name).id]) for name in joints]
    dofs = [int(model.jnt_dofadr[model.joint(name).id]) for name in joints]
    out, followers = np.empty(window.measured.shape), Followers(model, joints)
    for row, pose in enumerate(window.measured):
        data.qpos[qpos] = pose
        followers.place(data.qpos)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, data.qfrc_bias)
        out[row] = data.qfrc_bias[dofs]
    return out


def _errors(found: Diagnosis) -> dict[str, Any]:
    problem = found.problem
    windows = (*problem.fitted, *problem.proof)
    names = [w.episode.name for w in windows]
    out: dict[str, Any] = {"joints": list(problem.joints), "motions": names, "proof": len(problem.proof)}
    for label, fit in (("before", found.before), ("after", found.after)):
        positions = _positions(problem, fit.objective.simulated, fit.values, windows)
        out[label] = [
            [float(e) for e in np.sqrt(np.nanmean((p - w.measured)[:, problem.counted] ** 2, axis=0))]
            for p, w in zip(positions, windows, strict=True)
        ]
    return out


def _nuisance(found: Diagnosis) -> list[dict[str, Any]]:
    """Every usual number, its unit, and what it is published as, before and after."""
    before, after = _numbers(found.before), _numbers(found.after)
    usual = [one for one in found.after.objective.simulated.placements if one.effect.name in found.problem.settings.nuisance]
    published = {
        p.name: p
        for place in (*found.rounds[0].before.objective.simulated.placements, *usual)
        for p in replace(place, bounds=None, fixed=None).parameters(found.problem.robot.model)
    }
    return [usual_number(parameter, before.get(name), after.get(name)) for name, parameter in published.items()]


def usual_number(parameter: Parameter, before: dict[str, float] | None, after: dict[str, float] | None) -> dict[str, Any]:
    """A row of the table of usual numbers; one that is named is not fitted before, where the model has it as published.

    Args:
        parameter: as the published model gives it.
        before, after: value, low and high in `parameter.unit`, or None where the model has no such number of its own.
    """
    published = 0.0 if parameter.guessed else parameter.start
    stood = before or dict.fromkeys(("value", "low", "high"), published)
    return {"name": parameter.name, "unit": parameter.unit, "published": published, "before": stood, "after": after}


def _numbers(fit: Fit) -> dict[str, dict[str, float]]:
    intervals, values = fit.intervals(), fit.space.mapping(fit.values)
    return {name: {"value": value, "low": intervals[name][0], "high": intervals[name][1]} for name, value in values.items()}
