"""Hidden effects that no library of effects is expected to have, and that no sum of such effects makes up."""

import numpy as np

from edream.reality.plant import Moment, Term


class CableSnag(Term):
    """A cable that catches beyond `start` [rad] and lets go again `length` [rad] further: a saw tooth of height `torque` [N m]."""

    link_side = True

    def passive(self, now: Moment) -> np.ndarray:
        along = (now.q - self.values["start"]) / self.values["length"]
        rising = np.clip(along, 0.0, 1.0)
        torn = np.clip((along - 1.0) / 0.1, 0.0, 1.0)
        return -self.of("torque") * rising * (1.0 - torn)


class WarmStick(Term):
    """Dry friction `torque` [N m] that fades with the heat of its own work and comes back as the joint cools.

    heat' = |friction power| / `energy` [J] - heat / `cooling` [s]; friction = torque exp(-heat)
    """

    def start(self, shape: tuple[int, int]) -> None:
        self.heat = np.zeros(shape)

    def dry(self, up: np.ndarray, down: np.ndarray, now: Moment) -> tuple[np.ndarray, np.ndarray]:
        more = self.of("torque") * np.exp(-self.heat)
        self.heat = self.heat + now.step * (more * np.abs(now.w) / self.values["energy"] - self.heat / self.values["cooling"])
        return up + more, down + more


class Detent(Term):
    """Magnetic catches at `first` and `second` [rad], each pulling inward with up to `torque` [N m] over some `width` [rad]."""

    def passive(self, now: Moment) -> np.ndarray:
        total = np.zeros_like(now.q)
        for place in ("first", "second"):
            away = (now.q - self.values[place]) / self.values["width"]
            total -= away * np.exp(0.5 - 0.5 * away * away)
        return self.of("torque") * total


class CommutationRipple(Term):
    """A brake that comes and goes with the motor's angle: `coefficient` [N m s/rad] times sin(`count` theta)^2 w."""

    def passive(self, now: Moment) -> np.ndarray:
        return -self.of("coefficient") * np.square(np.sin(self.values["count"] * now.theta)) * now.w


class ProductDrag(Term):
    """Torque from the product of this joint's speed and another's: `coefficient` [N m s^2/rad^2], no part of rigid-body motion."""

    def passive(self, now: Moment) -> np.ndarray:
        return -self.of("coefficient") * now.v * np.abs(now.v[:, self.other, None])


class BeltSlip(Term):
    """A belt that jumps by `jump` [rad] when the load passes `torque` [N m] and jumps back when it passes minus that."""

    def start(self, shape: tuple[int, int]) -> None:
        self.slipped = np.zeros(shape)
        self.eased = np.zeros(shape)

    def error(self, error: np.ndarray, now: Moment) -> np.ndarray:
        limit = self.values["torque"]
        self.slipped = np.where(now.load > limit, 1.0, np.where(now.load < -limit, -1.0, self.slipped))
        self.eased = self.eased + (self.slipped - self.eased) * now.step / 0.005
        return error - self.of("jump") * self.eased


class RubberStop(Term):
    """Rubber that is met beyond `start` [rad], `stiffness` [N m/rad^2] times depth squared, and that pushes back at 40 % only."""

    link_side = True

    def passive(self, now: Moment) -> np.ndarray:
        depth = np.maximum(now.q - self.values["start"], 0.0)
        return -self.of("stiffness") * depth * depth * np.where(now.v > 0.0, 1.0, 0.4)
