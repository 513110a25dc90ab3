"""The state in which a replay begins: positions, velocities, and what servos and sensors still hold of the time before it."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import batch

from edream.core.effect import MEASURED_SUFFIX
from edream.core.episode import Episode
from edream.sim.window import Window

MEMORY = 2.0  # s of commands before a window that a filter or a slew limit may still hold
SETTLED = 60.0  # s for which a servo with an integral held its first pose before it was recorded
SETS_OUT = 1.3  # times as far as at the speed of the first row: twice from rest, once in steady motion


def start_velocity(window: Window) -> Float[np.ndarray, "J"]:
    """Joint velocities at the window's start [rad/s]: the slope of a line through up to five measurements around it.

    Where a recording begins, a joint that comes more than two and a half times as far in two rows as in one sets out from rest, as
    under a command that jumps; its velocity is 0.
    """
    episode, row = window.episode, window.first
    slope = _slope(episode, row)
    if row > 0 or len(episode.position) < 3:
        return slope
    clock, way = episode.times[1:3] - episode.times[0], episode.position[1:3] - episode.position[0]
    coasting = way[0] * clock[1] / clock[0]  # how far the first row's speed would have brought it
    sets_out = (way[0] * way[1] >= 0.0) & (np.abs(way[1]) > SETS_OUT * np.abs(coasting))
    return np.where(sets_out, 0.0, slope)


def _slope(episode: Episode, row: int) -> Float[np.ndarray, "J"]:
    rows = slice(max(0, row - 2), row + 3)
    clock = episode.times[rows] - episode.times[rows].mean()
    return clock @ (episode.position[rows] - episode.position[rows].mean(axis=0)) / (clock @ clock)


def recent_speed(window: Window, column: int, seconds: float) -> float:
    """How fast a joint was before a window begins: its speed's size, averaged with weights exp(-age / seconds) [rad/s]."""
    episode, row = window.episode, window.first
    ways = np.abs(np.diff(episode.position[: row + 1, column]))
    return float(np.sum(ways * np.exp((episode.times[1 : row + 1] - episode.times[row]) / seconds)) / seconds)


def start_actuators(
    simulations: batch.Batch, model: mujoco.MjModel, index: Sequence[dict[str, int]], rows: slice, window: Window, step: float
) -> None:
    """Fill the actuators' activations and history buffers with the commands given before the window began."""
    episode, now = window.episode, window.episode.times[window.first]
    act, history = simulations.bind("act"), simulations.bind("history")
    for column, one in enumerate(index):
        actuator = one["actuator"]
        if _holds_setpoint(model, actuator):
            act[rows, model.actuator_actadr[actuator]] = _setpoint(simulations, model, actuator, rows, window, column)
        samples = int(model.actuator_history[actuator][0])
        if samples:
            clock = now - step * np.arange(samples, 0, -1)
            past = episode.command[episode.in_force(clock), column]
            start = int(model.actuator_historyadr[actuator]) + 2 + samples
            history[rows, start : start + samples] = past


def _setpoint(
    simulations: batch.Batch, model: mujoco.MjModel, actuator: int, rows: slice, window: Window, column: int
) -> Float[np.ndarray, "N"]:
    """Where a filter or a slew limit has brought the setpoint as a window begins, after the commands of the last seconds."""
    episode, now = window.episode, window.episode.times[window.first]
    law = np.array(simulations.expand("actuator_dynprm")[rows, actuator])
    end = max(1, int(np.searchsorted(episode.command_times, now + 1e-9, side="right")))
    begin = min(int(np.searchsorted(episode.command_times, now - MEMORY)), end - 1)
    clock = np.append(episode.command_times[begin:end], max(now, episode.command_times[end - 1]))
    out = np.full(len(law), episode.command[begin, column])
    for told, passed in zip(episode.command[begin:end, column], np.diff(clock), strict=True):
        if int(model.actuator_dyntype[actuator]) == int(mujoco.mjtDyn.mjDYN_PID):
            out += np.clip(told - out, -law[:, 1] * passed, law[:, 1] * passed)
        else:
            out = told + (out - told) * np.exp(-passed / np.maximum(law[:, 0], 1e-9))
    return out


def integral_states(model: mujoco.MjModel, index: Sequence[dict[str, int]]) -> list[int]:
    """Addresses of the activations that integrate a servo's error."""
    return [
        int(model.actuator_actadr[one["actuator"]] + model.actuator_actnum[one["actuator"]] - 1)
        for _, one in _integrating(model, index)
    ]


def _integrating(model: mujoco.MjModel, index: Sequence[dict[str, int]]) -> list[tuple[int, dict[str, int]]]:
    """Joints, by number, whose servo has an integral, the last of a PID actuator's activations."""
    pid = int(mujoco.mjtDyn.mjDYN_PID)
    return [
        (column, one)
        for column, one in enumerate(index)
        if int(model.actuator_dyntype[one["actuator"]]) == pid
        and model.actuator_actnum[one["actuator"]] > int(model.actuator_dynprm[one["actuator"], 1] > 0.0)
    ]


def held_at_rest(
    simulations: batch.Batch, model: mujoco.MjModel, index: Sequence[dict[str, int]], forces: Float[np.ndarray, "N V 3"]
) -> Float[np.ndarray, "N I"]:
    """What each integral has gathered while the servo held a pose [rad s].

    It makes up for what the rest of the servo lacks to carry the joint, with the time constant kp / ki. `forces` [N m] are those of
    gravity, of springs and of the servos without their integrals.
    """
    gain, bias = simulations.expand("actuator_gainprm"), simulations.expand("actuator_biasprm")
    out = []
    for _, one in _integrating(model, index):
        ki, kp = gain[:, one["actuator"], 0], -bias[:, one["actuator"], 1]
        share = np.where(ki > 0.0, -np.expm1(-ki * SETTLED / kp) / np.where(ki > 0.0, ki, 1.0), SETTLED / kp)
        out.append((forces[:, one["dof"], 0] - forces[:, one["dof"], 1] - forces[:, one["drive"], 2]) * share)
    return np.stack(out, axis=1)


def error_since(window: Window, model: mujoco.MjModel, index: Sequence[dict[str, int]]) -> Float[np.ndarray, "I"]:
    """Integral of each such servo's error from the start of the recording to that of the window [rad s]."""
    episode, clock = window.episode, window.episode.times[: window.first + 1]
    asked = np.diff(clock) @ episode.command[episode.in_force(clock[:-1])]  # held from each row to the next
    error = asked - np.trapezoid(episode.position[: window.first + 1], clock, axis=0)
    return error[[column for column, _ in _integrating(model, index)]]


def start_sensors(
    simulations: batch.Batch, model: mujoco.MjModel, rows: slice, window: Window, step: float, delays: Mapping[str, np.ndarray]
) -> None:
    """Fill the sensors' history buffers with where the joints were before the window began, which their readings said later."""
    episode, now = window.episode, window.episode.times[window.first]
    history = simulations.bind("history")
    for sensor, joint in _delayed_sensors(model, episode.joints):
        samples, column = int(model.sensor_history[sensor][0]), episode.joints.index(joint)
        start = int(model.sensor_historyadr[sensor]) + 2 + samples
        clock = now - step * np.arange(samples, 0, -1) + np.expand_dims(delays.get(joint, np.zeros(1)), 1)
        history[rows, start : start + samples] = np.interp(clock, episode.times, episode.position[:, column])


def _delayed_sensors(model: mujoco.MjModel, joints: Sequence[str]) -> list[tuple[int, str]]:
    """Sensors of these joints that keep a history, and each one's joint."""
    named = [(sensor, model.sensor(sensor).name.removesuffix(MEASURED_SUFFIX)) for sensor in range(model.nsensor)]
    return [(sensor, joint) for sensor, joint in named if int(model.sensor_history[sensor][0]) and joint in joints]


def reading_delays(
    simulations: batch.Batch, model: mujoco.MjModel, window: Window, rows: slice
) -> dict[str, Float[np.ndarray, "N"]]:
    """Delay of each delayed joint's readings [s]; none where a recording begins, since what was read before is not known."""
    delayed = _delayed_sensors(model, window.episode.joints) if window.first else []
    return {joint: np.array(simulations.expand("sensor_delay")[rows, sensor]) for sensor, joint in delayed}


def before_its_reading(
    window: Window, joint: str, delay: Float[np.ndarray, "N"]
) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N"]]:
    """Where a joint is as a window begins, and how fast [rad, rad/s]: what its readings say a delay later."""
    episode, column = window.episode, window.episode.joints.index(joint)
    clock = episode.times[window.first] + delay
    last = min(int(np.searchsorted(episode.times, clock.max())), len(episode.times) - 1)
    rows = range(window.first, last + 1)
    slopes = [_slope(episode, row)[column] for row in rows]
    return np.interp(clock, episode.times, episode.position[:, column]), np.interp(clock, episode.times[rows], slopes)


def _holds_setpoint(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether the actuator's first activation is a setpoint on its way to the command (a filter or a slew limit)."""
    dynamics = int(model.actuator_dyntype[actuator])
    if dynamics == int(mujoco.mjtDyn.mjDYN_PID):
        return bool(model.actuator_dynprm[actuator, 1] > 0.0)
    return dynamics in (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
