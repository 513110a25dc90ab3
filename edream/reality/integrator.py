"""The make-believe robot in motion: implicit midpoint steps with exact stick-slip.

A step of length h goes through q' = q + h/2 v, where all forces are taken; their change over the step enters to first order:

    (M + h/2 D + h^2/4 K) (v1 - v) = h f(q', v) - p,      q1 = q' + h/2 v1

with p the impulse of dry friction: joints that stick have v1 = 0 and |p| <= h F, joints that slip have p = h F sign(v1). Which is
which is found by an active-set search over all joints at once. Source of the scheme: Hairer, Lubich, Wanner, Geometric Numerical
Integration, II.1; of the friction problem: Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988.

Where dry friction is smooth it is a force, F tanh(v / c) with a speed c, whose slope enters whole: it is too steep for the middle
of a step.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from edream.reality.plant import Moment, Plant, Term

SEARCHES = 8

BEARINGS = 0.25  # of the dry friction of a joint whose shaft gives or has play is on the link's side


@dataclass(frozen=True, eq=False)
class Track:
    """What happened: encoder values, link positions and link velocities at every step, (S, M, J), the first before any step."""

    encoder: Float[np.ndarray, "S M J"]
    link: Float[np.ndarray, "S M J"]
    velocity: Float[np.ndarray, "S M J"]


def move(
    plant: Plant,
    terms: Sequence[Term],
    start: Float[np.ndarray, "M J"],
    command: Float[np.ndarray, "S M J"],
    step: float,
    begin: float = 0.0,
) -> Track:
    """Let the robot follow commands from rest.

    Args:
        plant: the robot, before its hidden effects.
        terms: its hidden effects, in the order in which they follow one another.
        start: encoder positions [rad or m] at rest.
        command: what is commanded in the middle of each step [rad or m].
        step: length of a step [s].
        begin: time of the first step [s].
    """
    for term in terms:
        plant = term.plant(plant)
        term.start(start.shape)
    for term in terms:
        command = term.setpoint(command, step)
    steps, (motions, joints) = len(command), start.shape
    soft = np.flatnonzero(np.isfinite(plant.give))
    motor = np.arange(joints)
    motor[soft] = joints + np.arange(len(soft))
    y = np.empty((motions, joints + len(soft)))
    y[:, :joints] = (start - plant.offset) / plant.ratio
    y[:, motor] = y[:, :joints]
    u = np.zeros_like(y)
    side = np.zeros(y.shape, dtype=int)
    load = np.zeros_like(start)
    seen = slice(0, joints) if plant.sees == "link" else motor
    encoder, link, velocity = (np.empty((steps + 1, motions, joints)) for _ in range(3))
    encoder[0], link[0], velocity[0] = start, y[:, :joints], 0.0
    machine = _Machine(plant, tuple(terms), soft, motor, step)
    before = u
    for k in range(steps):
        y += 0.5 * step * u
        spin = 1.5 * u[:, :joints] - 0.5 * before[:, :joints]
        before = u
        error = command[k] - (plant.ratio * y[:, seen] + plant.offset)
        now = Moment(begin + (k + 0.5) * step, step, y[:, :joints], u[:, :joints], y[:, motor], u[:, motor], error, load)
        u, side, load = machine.kick(now, y, u, side, spin)
        y = y + 0.5 * step * u
        link[k + 1], velocity[k + 1] = y[:, :joints], u[:, :joints]
        encoder[k + 1] = plant.ratio * y[:, seen] + plant.offset
    return Track(encoder, link, velocity)


@dataclass(eq=False)
class _Machine:
    plant: Plant
    terms: tuple[Term, ...]
    soft: np.ndarray
    motor: np.ndarray
    step: float

    def __post_init__(self) -> None:
        plant, joints = self.plant, len(self.plant.joints)
        self.size = joints + len(self.soft)
        self.diagonal = np.arange(self.size)
        self.rotor = np.zeros(self.size)
        self.rotor[self.motor] = plant.armature
        self.collocated = np.ones(joints) if plant.sees == "motor" else np.isinf(plant.give).astype(float)
        self.sprung = bool(plant.stiffness.any())
        used = {
            name: [t for t in self.terms if getattr(type(t), name) is not getattr(Term, name)] for name in ("error", "drive", "dry")
        }
        self.error_terms, self.drive_terms, self.dry_terms = used["error"], used["drive"], used["dry"]
        self.passive_terms = [t for t in self.terms if type(t).passive is not Term.passive]

    def kick(
        self, now: Moment, y: np.ndarray, u: np.ndarray, side: np.ndarray, spin: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Velocities after the step, which way each joint slips, and the load that its gears passed on.

        `spin` is the links' velocity extrapolated to the middle of the step, for the centrifugal and Coriolis terms.
        """
        plant, h = self.plant, self.step
        joints = len(plant.joints)
        mass, bias = plant.tree.terms(now.q, spin, plant.gravity)
        drive, followed = self._servo(now)
        motor_force = drive - plant.damping * now.w
        link_force = -bias
        if self.sprung:
            link_force = link_force - plant.stiffness * (now.q - plant.rest)
        for term in self.passive_terms:
            torque = term.passive(now)
            if torque is not None and term.link_side:
                link_force = link_force + torque
            elif torque is not None:
                motor_force = motor_force + torque
        force = np.zeros_like(y)
        force[:, :joints] = link_force
        force[:, self.motor] += motor_force
        matrix = np.zeros((len(y), self.size, self.size))
        matrix[:, :joints, :joints] = mass
        implicit = (
            0.5 * h * (plant.damping + followed * plant.kd) + 0.25 * h * h * followed * self.collocated * plant.kp * plant.ratio
        )
        matrix[:, self.diagonal, self.diagonal] += self.rotor
        matrix[:, self.motor, self.motor] += implicit
        if len(self.soft):
            self._shafts(now, force, matrix)
        up = np.broadcast_to(plant.frictionloss, now.q.shape)
        down = up
        for term in self.dry_terms:
            up, down = term.dry(up, down, now)
        upper, lower = np.zeros_like(y), np.zeros_like(y)
        upper[:, self.motor], lower[:, self.motor] = h * up, h * down
        if len(self.soft):  # the bearings behind a shaft rub, too
            bearing = h * BEARINGS * plant.frictionloss[self.soft]
            for limit in (upper, lower):
                limit[:, self.motor[self.soft]] -= bearing
                limit[:, self.soft] += bearing
        rub = slope = np.zeros_like(y)
        if plant.smooth:
            rub, slope = _smooth(u, upper, lower, plant.smooth)
            upper = lower = np.zeros_like(y)
        matrix[:, self.diagonal, self.diagonal] += slope
        goal = (matrix @ u[..., None])[..., 0] + h * force - rub
        after, side, impulse = slide(matrix, goal, upper, lower, side)
        impulse = impulse + rub + slope * (after - u)
        load = motor_force - (impulse[:, self.motor] + (plant.armature + implicit) * (after - u)[:, self.motor]) / h
        return after, side, load

    def _servo(self, now: Moment) -> tuple[np.ndarray, np.ndarray]:
        """Servo torque, and 1 where it still follows the motion (0 where it is cut off)."""
        plant = self.plant
        for term in self.error_terms:
            now.error = term.error(now.error, now)
        torque = plant.kp * now.error - plant.kd * now.w
        followed = np.ones_like(torque)
        for term in self.drive_terms:
            before, torque = torque, term.drive(torque, now)
            if term.cuts:
                followed *= torque == before
        before, torque = torque, np.clip(torque, -plant.limit, plant.limit)
        return torque, followed * (torque == before)

    def _shafts(self, now: Moment, force: np.ndarray, matrix: np.ndarray) -> None:
        plant, h, a, b = self.plant, self.step, self.soft, self.motor[self.soft]
        twist = (now.theta - now.q)[:, a]
        gap = plant.gap[a]
        touch = (np.abs(twist) > gap) | (gap == 0.0)
        stiff, damp = touch * plant.give[a], touch * plant.give_damping[a]
        torque = stiff * (twist - np.clip(twist, -gap, gap)) + damp * (now.w - now.v)[:, a]
        force[:, a] += torque
        force[:, b] -= torque
        implicit = 0.25 * h * h * stiff + 0.5 * h * damp
        matrix[:, a, a] += implicit
        matrix[:, b, b] += implicit
        matrix[:, a, b] -= implicit
        matrix[:, b, a] -= implicit


def _smooth(u: np.ndarray, upper: np.ndarray, lower: np.ndarray, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Friction impulse at velocities u, (M, N), which comes up over `speed` [rad/s], and its slope."""
    along, most = np.tanh(u / speed), np.where(u > 0.0, upper, lower)
    return most * along, most * (1.0 - along**2) / speed


def slide(
    matrix: Float[np.ndarray, "M N N"], goal: Float[np.ndarray, "M N"], up: np.ndarray, down: np.ndarray, side: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocities after a step with dry friction: matrix v = goal - p.

    Args:
        matrix: inertia, symmetric and positive definite.
        goal: momentum without friction.
        up, down: largest friction impulse against positive and against negative motion, (M, N), not negative.
        side: the guess which joints slip up (1), down (-1) or stick (0), (M, N), such as the last step's answer.

    Returns:
        velocities, sides and friction impulses, each (M, N).
    """
    slippery = (up + down) <= 0.0
    after, impulse = goal, goal
    for _ in range(SEARCHES):
        stuck = side == 0
        impulse = np.where(side > 0, up, -down) * ~stuck
        if stuck.any():
            free = ~stuck
            reduced = matrix * (free[:, :, None] & free[:, None, :])
            index = np.arange(matrix.shape[1])
            reduced[:, index, index] += stuck
            after = np.linalg.solve(reduced, ((goal - impulse) * free)[..., None])[..., 0]
            impulse = np.where(stuck, goal - (matrix @ after[..., None])[..., 0], impulse)
            new = np.where(stuck, (impulse > up).astype(int) - (impulse < -down), side)
        else:
            after = np.linalg.solve(matrix, (goal - impulse)[..., None])[..., 0]
            new = side
        new = np.where((side * after < 0.0) & ~slippery, 0, new)
        if (new == side).all():
            break
        side = new
    return after, side, impulse
