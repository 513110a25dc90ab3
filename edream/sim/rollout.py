"""The one door into MuJoCo: open-loop replay of recorded commands under many parameter sets at once."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import batch

from edream.core.effect import MEASURED_SUFFIX, MOTOR_SUFFIX, joint_index
from edream.sim.followers import Followers
from edream.sim.hooks import batch_hooks
from edream.sim.mass import HAND_WEIGHT
from edream.sim.quiet import quiet
from edream.sim.rotor import has_rotor, wind_up
from edream.sim.servo import geared_readings
from edream.sim.simulation import SimulatedRobot, write_fields
from edream.sim.start import (
    before_its_reading,
    error_since,
    held_at_rest,
    integral_states,
    reading_delays,
    recent_speed,
    start_actuators,
    start_sensors,
    start_velocity,
)
from edream.sim.window import Window

CHUNK = 100
FEW = 64  # simulations
BatchHook = Callable[[batch.Batch], Callable[[], None]]


def rollout(
    simulated: SimulatedRobot,
    values: Float[np.ndarray, "N P"],
    windows: Sequence[Window],
    threads: int = 0,
    hook: BatchHook | None = None,
) -> list[Float[np.ndarray, "N T J"]]:
    """Replay each window's commands under each parameter set, sampled at the measured times.

    Commands hold from the first step at or after their own time to the next one's (for a robot that is `timed`, from their own
    time, half a step late as they are on average there); positions are interpolated between steps. A joint with a sensor
    `<joint>_measured` is read through it. A simulation that becomes unstable is NaN from there on.

    Args:
        simulated: the robot and its effects.
        values: parameter sets, in the order of `simulated.space`.
        windows: stretches to replay.
        threads: simulation threads; 0 for every core. The result does not depend on it.
        hook: makes from the batch a function that is called before each step, as `make_batch` of a hook file does.

    Returns:
        For each window, positions [rad], (N, T of that window, J).

    Raises:
        EdreamError: a recording lacks a condition that scales a parameter.
    """
    values = np.atleast_2d(np.asarray(values, dtype=float))
    return _run(simulated, np.broadcast_to(values, (len(windows), *values.shape)), windows, threads, hook)


def rollout_each(
    simulated: SimulatedRobot, values: Float[np.ndarray, "W P"], windows: Sequence[Window], threads: int = 0
) -> list[Float[np.ndarray, "T J"]]:
    """As `rollout`, with a parameter set of its own for each window: set w replays window w alone."""
    return [one[0] for one in _run(simulated, np.asarray(values, dtype=float)[:, None, :], windows, threads)]


def _run(
    simulated: SimulatedRobot, values: np.ndarray, windows: Sequence[Window], threads: int, hook: BatchHook | None = None
) -> list[np.ndarray]:
    """Replay window w under each of the sets `values[w]`, (W, N, P)."""
    order = np.argsort([-window.times[-1] for window in windows], kind="stable")
    ordered = [windows[i] for i in order]
    replay = _Replay(simulated, values[order], ordered, threads, hook)
    with quiet():
        results = replay.run()
    out: list[np.ndarray] = [results[0]] * len(windows)
    for place, result in zip(order, results, strict=True):
        out[place] = result
    return out


class _Replay:
    """One batch of N x W simulations, stepped together; windows come longest first so that ended ones drop off."""

    def __init__(
        self,
        simulated: SimulatedRobot,
        values: np.ndarray,
        windows: Sequence[Window],
        threads: int,
        hook: BatchHook | None = None,
    ) -> None:
        self.windows, self.model = windows, simulated.model
        self.w, self.n = values.shape[:2]
        self.step, self.timed = float(self.model.opt.timestep), simulated.robot.timed
        joints = windows[0].episode.joints
        self.index = [joint_index(self.model, joint) for joint in joints]
        self.followers = Followers(self.model, joints)
        self.ctrl_columns = np.array([one["ctrl"] for one in self.index])
        # simulation number = window * N + set, so that the simulations of ended windows are the last rows
        # hooks need all simulations at each step: a few are sooner done by one thread than two are brought together
        hooked = hook is not None or simulated.has_hooks
        self.batch = batch.Batch(self.model, self.n * self.w, 1 if hooked and self.n * self.w < FEW else threads)
        conditions = [window.episode.conditions for window in windows for _ in range(self.n)]
        numbers = simulated.quantities(values.reshape(self.w * self.n, -1), conditions)
        self._gains = _Servos(self.batch, self.model)
        write_fields(simulated, self.batch, numbers, np.array([one.get(HAND_WEIGHT, 0.0) for one in conditions]))
        self._gains.remember()
        own = batch_hooks(simulated, self.batch, numbers, _begins(windows, self.n), self._lately)
        self.hooks = hook(self.batch) if hook is not None else own
        self.record, self.columns, self.lag = _measured(self.model, joints)
        self.samples = [window.times / self.step for window in windows]
        self.steps = [int(np.ceil(s[-1])) + self.lag for s in self.samples]
        self._start(joints)

    def _start(self, joints: Sequence[str]) -> None:
        """Put every simulation at its window's first measured state, with the command history that led there."""
        self.batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        held = _mean_commands if self.timed else _held_commands
        self.commands = [held(window, self.step, steps) for window, steps in zip(self.windows, self.steps, strict=True)]
        integrals = integral_states(self.model, self.index)
        gathered = self._gathered(joints) if integrals else None
        for number, window in enumerate(self.windows):
            rows = self._rows(number)
            delays = reading_delays(self.batch, self.model, window, rows)
            state = [
                before_its_reading(window, joint, delays[joint]) if joint in delays else (position, speed)
                for joint, position, speed in zip(joints, window.measured[0], start_velocity(window), strict=True)
            ]
            self._place(rows, joints, state)
            start_actuators(self.batch, self.model, self.index, rows, window, self.step)
            start_sensors(self.batch, self.model, rows, window, self.step, delays)
            self.batch.bind("ctrl")[rows, self.ctrl_columns] = self.commands[number][0]
        if gathered is not None:
            self.batch.bind("act")[:, integrals] = gathered
        rotors = any(has_rotor(self.model, joint) for joint in joints)
        if rotors:
            self._wind_up()
        if rotors or self.hooks is not None or self.record == "sensordata":
            self.batch.forward()

    def _lately(self, dof: int, seconds: float) -> Float[np.ndarray, "N"]:
        """How fast a joint was as the windows begin (`recent_speed`) [rad/s]; 0 where it is not recorded."""
        columns = [column for column, one in enumerate(self.index) if one["dof"] == dof]
        speeds = [recent_speed(window, columns[0], seconds) if columns else 0.0 for window in self.windows]
        return np.repeat(speeds, self.n)

    def _rows(self, number: int) -> slice:
        return slice(number * self.n, (number + 1) * self.n)

    def _place(self, rows: slice, joints: Sequence[str], state: Sequence[tuple[Any, Any]]) -> None:
        """Put the joints of some simulations, rotors behind them and what follows them where encoders read so, at these speeds."""
        qpos, qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
        geared = geared_readings(self.model, joints)
        gear = self.batch.expand("actuator_gear") if geared else None
        for joint, index, (position, speed) in zip(joints, self.index, state, strict=True):
            own = gear[rows, geared[joint], 0] if gear is not None and joint in geared else 1.0
            qpos[rows, index["qpos"]] = position / own
            qvel[rows, index["dof"]] = speed / own
            twin = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, joint + MOTOR_SUFFIX)
            if twin >= 0:
                qpos[rows, self.model.jnt_qposadr[twin]] = position / own
                qvel[rows, self.model.jnt_dofadr[twin]] = speed / own
        for row in range(rows.start, rows.stop) if self.followers.joints else ():
            self.followers.place(qpos[row], qvel[row])

    def _gathered(self, joints: Sequence[str]) -> Float[np.ndarray, "N I"]:
        """What each servo's integral holds as the windows begin, all recordings having begun at rest."""
        for number, window in enumerate(self.windows):
            self._place(self._rows(number), joints, [(position, 0.0) for position in window.episode.position[0]])
            self.batch.bind("ctrl")[self._rows(number), self.ctrl_columns] = window.episode.command[0]
        lacking = self._forward("qfrc_bias", "qfrc_passive", "qfrc_actuator")
        out = held_at_rest(self.batch, self.model, self.index, lacking)
        for number, window in enumerate(self.windows):
            out[self._rows(number)] += error_since(window, self.model, self.index)
        self.batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE)
        return out

    def _wind_up(self) -> None:
        bind, expand = self.batch.bind, self.batch.expand
        fields = (expand("tendon_stiffness"), expand("tendon_range"), expand("tendon_lengthspring"), bind("eq_active"))
        wind_up(self.model, bind("qpos"), self._forward("qfrc_bias", "qfrc_passive") @ [1.0, -1.0], *fields)

    def _forward(self, *outputs: str) -> Float[np.ndarray, "N V outputs"]:
        """Some outputs in the present state; they are filled by calls that come after they were asked for."""
        asked = [self.batch.bind(name) for name in outputs]
        self.batch.forward()
        return np.stack(asked, axis=-1)

    def run(self) -> list[np.ndarray]:
        joints = len(self.index)
        out = [np.full((self.n, len(s), joints), np.nan) for s in self.samples]
        for number, window in enumerate(self.windows):
            out[number][:, 0] = window.measured[0]
        previous = np.array(self.batch.bind("qpos" if self.record == "qpos" else "sensordata"))[:, None, :]
        enabled = [_enabled(window, self.step) for window in self.windows]
        total = max(self.steps)
        cuts = sorted({*range(0, total, CHUNK), total, *(k for changes in enabled for k, _ in changes if 0 < k < total)})
        for begin, end in pairwise(cuts):
            active = sum(steps > begin for steps in self.steps)
            self._gains.switch(enabled, begin, self.n)
            grid = np.concatenate([previous[: active * self.n], self._advance(begin, end, active)], axis=1)
            self._sample(out, grid, begin, end, active)
            previous = grid[:, -1:]
        self._mark_unstable(out)
        return out

    def _advance(self, begin: int, end: int, active: int) -> np.ndarray:
        """Step the active simulations from grid point `begin` to `end`; returns what was recorded, (n, end - begin, width)."""
        control = np.zeros((active, end - begin, self.batch.bind("ctrl").shape[1]))
        for number in range(active):
            held = self.commands[number]
            rows = np.minimum(np.arange(begin, end), len(held) - 1)
            control[number][:, self.ctrl_columns] = held[rows]
        ids = None if active == self.w else np.arange(active * self.n)
        if self.hooks is None:
            repeated = np.repeat(control, self.n, axis=0)
            return self.batch.rollout(end - begin, repeated, record=(self.record,), ids=ids)[self.record]
        live, ctrl = self.batch.bind(self.record), self.batch.bind("ctrl")
        grid = np.empty((active * self.n, end - begin, live.shape[1]))
        for k in range(end - begin):
            ctrl[: active * self.n] = np.repeat(control[:, k], self.n, axis=0)
            self.hooks()
            self.batch.step(ids=ids)
            grid[:, k] = live[: active * self.n]
        return grid

    def _sample(self, out: list[np.ndarray], grid: np.ndarray, begin: int, end: int, active: int) -> None:
        for number in range(active):
            at = self.samples[number] + self.lag
            i, j = np.searchsorted(at, [begin, end], side="right")
            if begin == 0 and self.lag == 0:
                i = max(i, 1)
            if j <= i:
                continue
            low = np.minimum(np.floor(at[i:j]).astype(int), end - 1)
            fraction = (at[i:j] - low)[:, None]
            rows = grid[number * self.n : (number + 1) * self.n][:, :, self.columns]
            out[number][:, i:j] = rows[:, low - begin] * (1.0 - fraction) + rows[:, low - begin + 1] * fraction

    def _mark_unstable(self, out: list[np.ndarray]) -> None:
        bad = self.batch.warning[:, UNSTABLE, 1].any(axis=1)
        for number in range(self.w):
            out[number][bad[number * self.n : (number + 1) * self.n], 1:] = np.nan


UNSTABLE = [int(w) for w in (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)]


class _Servos:
    """Servo gains of a batch, set to zero while a recording's torque is off."""

    def __init__(self, simulations: batch.Batch, model: mujoco.MjModel) -> None:
        self.batch, self.model = simulations, model
        self.off: dict[int, bool] = {}

    def remember(self) -> None:
        self.fields = {name: self.batch.expand(name) for name in ("actuator_gainprm", "actuator_biasprm")}
        self.full = {name: field.copy() for name, field in self.fields.items()}

    def switch(self, enabled: Sequence[Sequence[tuple[int, bool]]], step: int, n: int) -> None:
        driven = self.model.actuator_ctrlnum > 0
        for number, changes in enumerate(enabled):
            off = not [on for k, on in changes if k <= step][-1]
            if off == self.off.get(number, False):
                continue
            self.off[number] = off
            rows = slice(number * n, (number + 1) * n)
            for name, field in self.fields.items():
                field[rows] = self.full[name][rows]
                if off:
                    field[rows, driven] = 0.0


def _measured(model: mujoco.MjModel, joints: Sequence[str]) -> tuple[str, np.ndarray, int]:
    """What to record, which columns are the joints, and by how many steps the record lags the state.

    Sensors describe the state before the step that they are read after, so they lag by one.
    """
    sensors = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, joint + MEASURED_SUFFIX) for joint in joints]
    if all(sensor < 0 for sensor in sensors):
        return "qpos", np.array([joint_index(model, joint)["qpos"] for joint in joints]), 0
    return "sensordata", np.array([model.sensor_adr[sensor] for sensor in sensors]), 1


def _begins(windows: Sequence[Window], n: int) -> Float[np.ndarray, "N"]:
    """Time of each simulation's first measurement since its recording began [s]."""
    return np.repeat([window.episode.times[window.first] - window.episode.times[0] for window in windows], n)


def _held_commands(window: Window, step: float, steps: int) -> Float[np.ndarray, "K J"]:
    """The command in force at each step (zero-order hold)."""
    episode = window.episode
    return episode.command[episode.in_force(episode.times[window.first] + step * np.arange(steps))]


def _mean_commands(window: Window, step: float, steps: int) -> Float[np.ndarray, "K J"]:
    """The mean over half a step before and after each step's begin of the command in force then.

    A command between two steps is then neither early nor late beside the others, which on a recording whose clock is not that of
    the steps is worth more than the rest of the integrator's error; on average it is half a step late, as with `_held_commands`.
    """
    episode = window.episode
    edges = episode.times[window.first] + step * (np.arange(steps + 1) - 0.5)
    begins, command = episode.command_times, episode.command
    gathered = np.concatenate([np.zeros((1, command.shape[1])), np.cumsum(command[:-1] * np.diff(begins)[:, None], axis=0)])
    row = episode.in_force(edges)
    return np.diff(gathered[row] + command[row] * (edges - begins[row])[:, None], axis=0) / step


def _enabled(window: Window, step: float) -> list[tuple[int, bool]]:
    """Step numbers at which torque goes on or off, with the state at step 0 first."""
    episode = window.episode
    if episode.enabled is None:
        return [(0, True)]
    now = episode.times[window.first]
    row = max(0, int(np.searchsorted(episode.command_times, now + 1e-9, side="right")) - 1)
    changes = [(0, bool(episode.enabled[row]))]
    for k in range(row + 1, len(episode.command_times)):
        if bool(episode.enabled[k]) != changes[-1][1]:
            changes.append((max(1, round((episode.command_times[k] - now) / step)), bool(episode.enabled[k])))
    return changes
