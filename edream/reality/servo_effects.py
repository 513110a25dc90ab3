"""Hidden effects between the command and the motor's torque, and between the encoder and the file."""

import numpy as np
from scipy.signal import lfilter

from edream.reality.plant import Moment, Plant, Term


class ServoGain(Term):
    """The motor gives `scale` times the torque that the servo asks for."""

    def drive(self, torque: np.ndarray, now: Moment) -> np.ndarray:
        return torque * np.where(self.on > 0, self.values["scale"], 1.0)


class TorqueSaturation(Term):
    """The motor gives no more than `torque` [N m]."""

    cuts = True

    def drive(self, torque: np.ndarray, now: Moment) -> np.ndarray:
        most = np.where(self.on > 0, self.values["torque"], np.inf)
        return np.clip(torque, -most, most)


class TorqueSpeed(Term):
    """The torque available in the direction of motion falls linearly, `torque` [N m] at rest, none at `velocity` [rad/s]."""

    cuts = True

    def drive(self, torque: np.ndarray, now: Moment) -> np.ndarray:
        most = np.where(self.on > 0, self.values["torque"], np.inf)
        share = np.where(self.on > 0, now.w / self.values["velocity"], 0.0)
        with np.errstate(invalid="ignore"):
            high = np.where(np.isinf(most), np.inf, most * np.clip(1.0 - share, 0.0, 1.0))
            low = np.where(np.isinf(most), np.inf, most * np.clip(1.0 + share, 0.0, 1.0))
        return np.clip(torque, -low, high)


class IntegralAction(Term):
    """The servo also integrates its error with gain `gain` [N m/(rad s)], up to a third of what the motor can give."""

    def start(self, shape: tuple[int, int]) -> None:
        self.sum = np.zeros(shape)

    def plant(self, plant: Plant) -> Plant:
        self.most = np.where(np.isfinite(plant.limit), plant.limit / 3.0, np.inf)
        return plant

    def drive(self, torque: np.ndarray, now: Moment) -> np.ndarray:
        self.sum = np.clip(self.sum + now.step * self.of("gain") * now.error, -self.most, self.most)
        return torque + self.sum


class DeadZone(Term):
    """The servo does nothing about errors below `width` [rad], and takes larger ones from there."""

    def error(self, error: np.ndarray, now: Moment) -> np.ndarray:
        width = self.of("width")
        return error - np.clip(error, -width, width)


class GainDrift(Term):
    """The motor's torque changes by the share `rate` [1/s], as with a warming magnet or a falling supply."""

    def drive(self, torque: np.ndarray, now: Moment) -> np.ndarray:
        return torque * np.maximum(1.0 + self.of("rate") * max(now.time, 0.0), 0.1)


class SlewLimit(Term):
    """The setpoint runs after the command no faster than `rate` [rad/s]."""

    def setpoint(self, command: np.ndarray, step: float) -> np.ndarray:
        most = np.where(self.on > 0, self.values["rate"], np.inf) * step
        if np.isinf(most).all():
            return command
        out = np.empty_like(command)
        now = command[0]
        for k, wanted in enumerate(command):
            now = np.where(np.isinf(most), wanted, now + np.clip(wanted - now, -most, most))
            out[k] = now
        return out


class ActuatorDelay(Term):
    """Commands reach the servo `time` [s] late."""

    def setpoint(self, command: np.ndarray, step: float) -> np.ndarray:
        late = self.values["time"] / step
        if late == 0.0:
            return command
        whole, part = int(late), late - int(late)
        padded = np.concatenate([np.repeat(command[:1], whole + 1, axis=0), command])
        delayed = (1.0 - part) * padded[1 : len(command) + 1] + part * padded[: len(command)]
        return np.where(self.on > 0, delayed, command)


class ActuatorLag(Term):
    """The setpoint follows the command as a first-order filter with time constant `time` [s]."""

    def setpoint(self, command: np.ndarray, step: float) -> np.ndarray:
        if self.values["time"] == 0.0:
            return command
        decay = np.exp(-step / self.values["time"])
        lagged, _ = lfilter([1.0 - decay], [1.0, -decay], command, axis=0, zi=decay * command[:1])
        return np.where(self.on > 0, lagged, command)


class SensorDelay(Term):
    """The recorder gets positions that are `time` [s] old; the servo sees them fresh."""

    def record(self, position: np.ndarray, times: np.ndarray) -> np.ndarray:
        if self.values["time"] == 0.0:
            return position
        old = [np.interp(times - self.values["time"], times, column) for column in position.T]
        return np.where(self.on > 0, np.stack(old, axis=1), position)


class EncoderOffset(Term):
    """The encoder's zero stands `angle` [rad] off: it reads that much too high."""

    def plant(self, plant: Plant) -> Plant:
        return plant.with_values(offset=plant.offset + self.of("angle"))


class GearRatio(Term):
    """The encoder reads `scale` times the joint's position."""

    def plant(self, plant: Plant) -> Plant:
        return plant.with_values(ratio=plant.ratio * np.where(self.on > 0, self.values["scale"], 1.0))
