"""Motions as a person makes them with a leader arm, mixed with those that an engineer would ask for."""

from collections.abc import Callable, Iterator

import mujoco
import numpy as np
from jaxtyping import Float

from edream.reality.truth import joint_range

Rows = Float[np.ndarray, "K J"]


def commands(
    model: mujoco.MjModel, rng: np.random.Generator, motions: int, seconds: float, rate: float
) -> Float[np.ndarray, "M K J"]:
    """Command rows for several motions, within the joints' ranges with a margin.

    Args:
        model: the nominal robot.
        rng: where chance comes from.
        motions: how many.
        seconds: length of each [s].
        rate: command rows per second [Hz].
    """
    rows = round(seconds * rate)
    return np.stack([_motion(_Hand(model, rng, rate), rows, first) for first in range(motions)])


class _Hand:
    """What one motion needs to know: the room that each joint has, and the clock."""

    def __init__(self, model: mujoco.MjModel, rng: np.random.Generator, rate: float) -> None:
        low, high = joint_range(model)
        full = high - low
        is_hinge = np.asarray(model.jnt_type) == int(mujoco.mjtJoint.mjJNT_HINGE)
        margin = np.where(is_hinge, np.minimum(np.clip(0.15 * full, 0.1, 0.4), 0.25 * full), 0.12 * full)
        # Three radians about the middle: teleoperators stay there, and it keeps fast reaches at human speed.
        middle, half = 0.5 * (low + high), np.minimum(0.5 * full - margin, np.where(is_hinge, 1.5, np.inf))
        self.low, self.high = middle - half, middle + half
        self.span = np.where(is_hinge, np.minimum(full / 3.0, 1.0), full / 3.0)
        self.is_hinge = is_hinge
        self.rng, self.rate = rng, rate

    def rows(self, seconds: float) -> int:
        return max(round(seconds * self.rate), 1)

    def pose(self) -> np.ndarray:
        return self.rng.uniform(self.low, self.high)

    def joint(self) -> int:
        return int(self.rng.integers(len(self.low)))

    def inside(self, q: np.ndarray) -> np.ndarray:
        return np.clip(q, self.low, self.high)


def _motion(hand: _Hand, rows: int, first: int) -> Rows:
    """One motion: a hold, then segments drawn at random; the first segment goes through all sorts from motion to motion."""
    sorts: tuple[Callable[[_Hand, np.ndarray], Rows], ...] = (_reach, _sweep, _steps, _chirp, _reach, _wiggle)
    q = hand.pose()
    parts = [np.repeat(q[None], hand.rows(hand.rng.uniform(0.2, 0.4)), axis=0)]
    count = len(parts[0])
    for sort in _order(hand, sorts, first):
        part = sort(hand, q)
        parts.append(part)
        q, count = part[-1], count + len(part)
        if count >= rows:
            break
    return np.concatenate(parts)[:rows]


def _order(hand: _Hand, sorts: tuple, first: int) -> Iterator[Callable[[_Hand, np.ndarray], Rows]]:
    yield sorts[first % len(sorts)]
    while True:
        yield sorts[int(hand.rng.choice(len(sorts), p=[0.3, 0.15, 0.15, 0.15, 0.15, 0.1]))]


def _smooth(q: np.ndarray, goal: np.ndarray, rows: int) -> Rows:
    """Minimum-jerk path (Flash and Hogan, 1985)."""
    s = np.arange(1, rows + 1)[:, None] / rows
    return q + (goal - q) * (10.0 * s**3 - 15.0 * s**4 + 6.0 * s**5)


def _hold(q: np.ndarray, rows: int) -> Rows:
    return np.repeat(q[None], rows, axis=0)


def _reach(hand: _Hand, q: np.ndarray) -> Rows:
    """A reach with some of the joints, at human speed, and a pause."""
    moved = hand.rng.random(len(q)) < hand.rng.choice([0.3, 0.7, 1.0])
    goal = np.where(moved, hand.pose(), q)
    furthest = np.max(np.abs(goal - q) / hand.span)
    path = _smooth(q, goal, hand.rows(max(0.5, furthest * hand.rng.uniform(0.8, 1.5))))
    return np.concatenate([path, _hold(goal, hand.rows(hand.rng.uniform(0.2, 0.7)))])


def _sweep(hand: _Hand, q: np.ndarray) -> Rows:
    """One joint slowly there and back at constant speed."""
    joint, goal = hand.joint(), q.copy()
    room = hand.high[joint] if q[joint] < 0.5 * (hand.low + hand.high)[joint] else hand.low[joint]
    goal[joint] = q[joint] + np.sign(room - q[joint]) * min(abs(room - q[joint]), 0.5 * hand.span[joint])
    rows = hand.rows(hand.rng.uniform(0.9, 1.8))
    up = np.linspace(q, goal, rows + 1)[1:]
    return np.concatenate([up, np.linspace(goal, q, rows + 1)[1:], _hold(q, hand.rows(0.2))])


def _steps(hand: _Hand, q: np.ndarray) -> Rows:
    """Sudden small moves of one or two joints, there and back."""
    goal = q.copy()
    for joint in {hand.joint(), hand.joint()}:
        goal[joint] += hand.rng.choice([-1.0, 1.0]) * hand.rng.uniform(0.06, 0.2) * hand.span[joint]
    wait = hand.rows(hand.rng.uniform(0.4, 0.6))
    return np.concatenate([_hold(hand.inside(goal), wait), _hold(q, wait)])


def _chirp(hand: _Hand, q: np.ndarray) -> Rows:
    """One joint back and forth, ever faster."""
    joint, seconds = hand.joint(), hand.rng.uniform(2.0, 3.0)
    high = hand.rng.uniform(3.0, 5.0)
    t = np.arange(1, hand.rows(seconds) + 1) / hand.rate
    phase = 2.0 * np.pi * (0.4 * t + 0.5 * (high - 0.4) / seconds * t * t)
    rows = _hold(q, len(t))
    swing = hand.rng.uniform(0.06, 0.15) * hand.span[joint]
    rows[:, joint] += np.sin(phase) * swing * np.minimum(1.0, 4.0 * (1.0 - t / seconds))
    return np.concatenate([hand.inside(rows), _hold(q, hand.rows(0.15))])


def _wiggle(hand: _Hand, q: np.ndarray) -> Rows:
    """Small slow reversals of several joints, of growing size, about a pose."""
    rows = hand.rows(hand.rng.uniform(1.6, 2.4))
    t = np.arange(1, rows + 1) / rows
    turns = hand.rng.integers(2, 5, len(q))
    swing = hand.rng.uniform(0.01, 0.08, len(q)) * hand.span
    path = q + swing * t[:, None] * np.sin(2.0 * np.pi * turns * t[:, None])
    return hand.inside(path)
