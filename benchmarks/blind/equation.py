"""The equation residual of measured motions, and what baselines fit to it.

residual = (torque that the motion needed, by inverse dynamics) - (torque that the published servo gave)
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from scipy.signal import savgol_filter

from edream.core.effect import Effect, State, joint_index
from edream.core.parameters import Parameter
from edream.diagnosis.problem import Problem
from edream.sim.window import Window

SMOOTHED = 9  # rows of the quadratic filter that differentiates positions
THRESHOLD = 0.05  # share of the residual's size below which a term is dropped
REAL = 0.05  # share of a joint's residual that a term must explain to be a name
HIDDEN_UNITS = 24
MOST_ROWS = 4000
NUISANCE_FEATURES = ("servo_gain", "viscous", "coulomb", "armature")


@dataclass(frozen=True, eq=False)
class Moments:
    """Every row of some motions, (T, J) each: position, speed, acceleration, command, gravity load, residual torque; time (T,)."""

    q: Float[np.ndarray, "T J"]
    v: Float[np.ndarray, "T J"]
    a: Float[np.ndarray, "T J"]
    u: Float[np.ndarray, "T J"]
    load: Float[np.ndarray, "T J"]
    torque: Float[np.ndarray, "T J"]
    time: Float[np.ndarray, "T"]


def moments(problem: Problem) -> Moments:
    """The equation residual on the fitted motions."""
    parts = [_motion(problem, window) for window in problem.fitted]
    return Moments(*(np.concatenate([getattr(p, name) for p in parts]) for name in Moments.__dataclass_fields__))


def _motion(problem: Problem, window: Window) -> Moments:
    model = problem.robot.spec().compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)
    episode, clock = window.episode, window.times
    step = float(np.median(np.diff(clock)))
    even = np.arange(clock[0], clock[-1], step)
    measured = np.stack([np.interp(even, clock, column) for column in window.measured.T], axis=1)
    q, v, a = (savgol_filter(measured, SMOOTHED, 3, deriv=order, delta=step, axis=0) for order in (0, 1, 2))
    start = float(episode.times[window.first]) - float(clock[0])
    rows = np.clip(np.searchsorted(episode.command_times, even + start, side="right") - 1, 0, None)
    u = episode.command[rows]
    index = [joint_index(model, joint) for joint in episode.joints]
    qpos, dofs, ctrl = ([one[key] for one in index] for key in ("qpos", "dof", "ctrl"))
    needed, given, load = np.empty_like(q), np.empty_like(q), np.empty_like(q)
    for row in range(len(even)):
        data.qpos[qpos], data.qvel[dofs], data.ctrl[ctrl] = q[row], v[row], u[row]
        mujoco.mj_forward(model, data)
        given[row], load[row] = data.qfrc_actuator[dofs], data.qfrc_bias[dofs]
        data.qacc[dofs] = a[row]
        mujoco.mj_inverse(model, data)
        needed[row] = data.qfrc_inverse[dofs]
    return Moments(q, v, a, u, load, needed - given, even - even[0])


def features(m: Moments, joint: int) -> dict[str, Float[np.ndarray, "T"]]:
    """Torque features of one joint under the library's names."""
    q, v, a, error, load = m.q[:, joint], m.v[:, joint], m.a[:, joint], (m.u - m.q)[:, joint], m.load[:, joint]
    direction = np.tanh(v / 0.02)
    return {
        "servo_gain": error,
        "viscous": v,
        "coulomb": direction,
        "armature": a,
        "quadratic_drag": v * np.abs(v),
        "stribeck": direction * np.exp(-((v / 0.1) ** 2)),
        "load_friction": direction * np.abs(load),
        "directional_efficiency": np.abs(load),
        "payload": load,
        "spring": q,
        "hardening_spring": q**3,
        "constant_torque": np.ones_like(q),
        "position_friction": direction * q,
        "actuator_delay": np.gradient(m.u[:, joint], axis=0) / max(float(np.median(np.diff(m.time))), 1e-6),
        "integral_action": _integral(error, m.time),
        "gain_fade": m.time * error,
        "friction_fade": m.time * direction,
        **{f"joint_coupling<-{other}": m.q[:, other] for other in range(m.q.shape[1]) if other != joint},
    }


def _integral(error: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Running sum of the error over time, from nothing at each motion's start."""
    steps = np.clip(np.diff(time, prepend=0.0), 0.0, None)
    total = np.cumsum(error * steps)
    starts = np.maximum.accumulate(np.where(time == 0.0, np.arange(len(time)), 0))
    return total - total[starts]


def stlsq(columns: Float[np.ndarray, "T F"], target: Float[np.ndarray, "T"], threshold: float) -> Float[np.ndarray, "F"]:
    """Sequentially thresholded least squares: fit, drop terms that add less than `threshold` of the target's size, fit again.

    Source: Brunton, Proctor, Kutz, PNAS 113(15), 2016.
    """
    size = np.linalg.norm(columns, axis=0)
    scaled = columns / np.maximum(size, 1e-12)
    kept = size > 1e-9
    found = np.zeros(columns.shape[1])
    for _ in range(10):
        found = np.zeros(columns.shape[1])
        found[kept] = np.linalg.lstsq(scaled[:, kept], target, rcond=None)[0]
        smaller = kept & (np.abs(found) >= threshold * np.linalg.norm(target))
        if (smaller == kept).all():
            break
        kept = smaller
    return found / np.maximum(size, 1e-12)


def fit_sparse(problem: Problem) -> dict[str, Any]:
    """The term, nuisance apart, that explains most of a joint's equation residual, by how much worse the fit is without it."""
    m = moments(problem)
    names = problem.fitted[0].episode.joints
    best: tuple[float, str | None] = (REAL, None)
    for joint, name in enumerate(names):
        terms = features(m, joint)
        columns = np.stack(list(terms.values()), axis=1)
        target = m.torque[:, joint]
        coefficients = stlsq(columns, target, THRESHOLD)
        kept = np.flatnonzero(coefficients)
        full = _left(columns[:, kept], target)
        for number in kept:
            feature = list(terms)[number]
            share = (_left(columns[:, kept[kept != number]], target) - full) / max(float(target @ target), 1e-18)
            if feature not in NUISANCE_FEATURES and share > best[0]:
                best = share, _labelled(problem, feature, name, names)
    return {"named": best[1]}


def _left(columns: np.ndarray, target: np.ndarray) -> float:
    if not columns.size:
        return float(target @ target)
    rest = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
    return float(rest @ rest)


def _labelled(problem: Problem, feature: str, joint: str, names: Sequence[str]) -> str:
    kind, arrow, other = feature.partition("<-")
    model = problem.robot.model
    place = model.body(int(model.jnt_bodyid[model.joint(joint).id])).name if kind == "payload" else joint
    return f"{kind}[{place}{arrow}{names[int(other)] if other else ''}]"


Net = Mapping[str, np.ndarray]


def fit_nets(problem: Problem) -> dict[str, Net]:
    """A network for each joint, from positions, speeds and errors of all joints to its residual torque."""
    m = moments(problem)
    x = np.concatenate([m.q, m.v, m.u - m.q], axis=1)
    rng = np.random.default_rng([problem.settings.seed, 17])
    rows = rng.permutation(len(x))[:MOST_ROWS]
    return {joint: _net(x[rows], m.torque[rows, j], rng) for j, joint in enumerate(problem.fitted[0].episode.joints)}


def _net(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> Net:
    """One hidden layer of tanh units, by L-BFGS with weight decay."""
    mean, spread, size = x.mean(axis=0), x.std(axis=0) + 1e-9, float(y.std()) + 1e-9
    z, target = (x - mean) / spread, y / size
    width, inputs = HIDDEN_UNITS, x.shape[1]
    cuts = np.cumsum([inputs * width, width, width])

    def parts(w: np.ndarray) -> tuple[np.ndarray, ...]:
        first, bias, second, last = np.split(w, cuts)
        return first.reshape(inputs, width), bias, second, last

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        first, bias, second, last = parts(w)
        hidden = np.tanh(z @ first + bias)
        wrong = hidden @ second + last[0] - target
        back = np.outer(wrong, second) * (1.0 - hidden**2)
        gradient = np.concatenate([(z.T @ back).ravel(), back.sum(axis=0), hidden.T @ wrong, [wrong.sum()]]) / len(z)
        return 0.5 * float(wrong @ wrong) / len(z) + 5e-5 * float(w @ w), gradient + 1e-4 * w

    start = rng.normal(0.0, 1.0, cuts[-1] + 1) / np.sqrt(inputs)
    first, bias, second, last = parts(minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 200}).x)
    return {"mean": mean, "spread": spread, "first": first, "bias": bias, "second": second * size, "last": last * size}


def net_torque(net: Net, state: State, index: Mapping[str, int], values: Mapping[str, Any]) -> None:
    """The network's torque on its joint; a robot whose joints are all recorded, in the order of its degrees of freedom."""
    joints = len(net["mean"]) // 3
    q, v, u = state.qpos[:, :joints], state.qvel[:, :joints], state.ctrl[:, :joints]
    z = (np.concatenate([q, v, u - q], axis=1) - net["mean"]) / net["spread"]
    state.torque[:, index["dof"]] += np.tanh(z @ net["first"] + net["bias"]) @ net["second"] + net["last"][0]


class TorqueNet(Effect):
    """A network's torque on one joint."""

    name = "torque_net"
    summary = "a learned torque"
    place = "joint"
    hook: Callable[..., None] | None = None

    def __init__(self, net: Net) -> None:
        self.hook = partial(net_torque, net)

    def parameters(self, model: mujoco.MjModel, targets: Sequence[str]) -> tuple[Parameter, ...]:
        """None: the weights are fixed."""
        return ()
