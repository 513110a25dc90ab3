"""Hidden effects that take energy: friction in its many forms."""

import numpy as np

from edream.reality.plant import Moment, Plant, Term


class Viscous(Term):
    """Drag proportional to speed, `coefficient` [N m s/rad]."""

    def plant(self, plant: Plant) -> Plant:
        return plant.with_values(damping=plant.damping + self.of("coefficient"))


class QuadraticDrag(Term):
    """Drag proportional to speed squared, `coefficient` [N m s^2/rad^2]."""

    def passive(self, now: Moment) -> np.ndarray:
        return -self.of("coefficient") * now.w * np.abs(now.w)


class Coulomb(Term):
    """Dry friction of one size, `torque` [N m]."""

    def plant(self, plant: Plant) -> Plant:
        return plant.with_values(frictionloss=plant.frictionloss + self.of("torque"))


class AsymmetricCoulomb(Term):
    """Dry friction that is larger one way: `torque` [N m] more against positive and as much less against negative motion."""

    def dry(self, up: np.ndarray, down: np.ndarray, now: Moment) -> tuple[np.ndarray, np.ndarray]:
        more = self.of("torque")
        return np.maximum(up + more, 0.0), np.maximum(down - more, 0.0)


class Stribeck(Term):
    """Extra dry friction near standstill: `torque` [N m] times exp(-(w / `velocity` [rad/s])^2)."""

    def dry(self, up: np.ndarray, down: np.ndarray, now: Moment) -> tuple[np.ndarray, np.ndarray]:
        more = self.of("torque") * np.exp(-np.square(now.w / self.values["velocity"]))
        return up + more, down + more


class LoadFriction(Term):
    """Extra dry friction, the share `share` of the torque that the gears pass on."""

    def dry(self, up: np.ndarray, down: np.ndarray, now: Moment) -> tuple[np.ndarray, np.ndarray]:
        more = self.of("share") * np.abs(now.load)
        return up + more, down + more


class DirectionalEfficiency(Term):
    """Gears that lose the share `drive` of the load when the motor drives it and `back` when the load drives the motor."""

    def dry(self, up: np.ndarray, down: np.ndarray, now: Moment) -> tuple[np.ndarray, np.ndarray]:
        lifting, lowering = self.of("drive") * np.abs(now.load), self.of("back") * np.abs(now.load)
        against = now.load > 0.0
        return up + np.where(against, lifting, lowering), down + np.where(against, lowering, lifting)


class Presliding(Term):
    """Dahl friction: a bristle that bends over `width` [rad] before it slips at `torque` [N m].

    After a displacement d in one direction the bristle's torque has approached its limit by the factor exp(-|d| / width).
    """

    def start(self, shape: tuple[int, int]) -> None:
        self.bristle = np.zeros(shape)

    def passive(self, now: Moment) -> np.ndarray:
        limit = self.of("torque") * np.sign(now.w)
        held = np.exp(-np.abs(now.w) * now.step / self.values["width"])
        self.bristle = limit + (self.bristle - limit) * held
        return -self.bristle


class PositionFriction(Term):
    """Extra dry friction around a place: `torque` [N m] at `centre` [rad], fading over `width` [rad] as a bell."""

    def dry(self, up: np.ndarray, down: np.ndarray, now: Moment) -> tuple[np.ndarray, np.ndarray]:
        far = (now.q - self.values["centre"]) / self.values["width"]
        more = self.of("torque") * np.exp(-0.5 * far * far)
        return up + more, down + more


class FrictionDrift(Term):
    """Dry friction changes by the share `rate` [1/s] as the gears warm up."""

    def dry(self, up: np.ndarray, down: np.ndarray, now: Moment) -> tuple[np.ndarray, np.ndarray]:
        factor = np.maximum(1.0 + self.of("rate") * max(now.time, 0.0), 0.05)
        return up * factor, down * factor
