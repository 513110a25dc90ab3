"""The scripted expert: an arm taken along a task's waypoints by inverse kinematics; it watches its joints as a person the hand."""

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.bench import Bench
from edream.core.policy import Observation
from edream.core.task import Layout, Task, Waypoint
from edream.sim.reach import Reach, reachable, turn_between
from edream.sim.robot import RobotModel

PULL = 2.5  # rate at which the expert corrects what it sees [1/s]
SIGHT = 0.12  # what it sees of its own moves is so old [s]
NEAR = 0.012  # joints within this of where they should be have arrived [rad]
PATIENCE = 0.8  # longest wait for that [s]
FAR = 0.3  # a turn of the hand beyond which it does not keep to a line [rad]
FURTHEST = 0.4  # largest correction of a joint [rad]
Hand = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]


class Expert:
    """Position commands that carry out a task, one control step after another.

    Args:
        robot: the published robot, as its maker drew it.
        bench: its workplace.
        task: what to do.
        rate: control steps per second [Hz].
    """

    def __init__(self, robot: RobotModel, bench: Bench, task: Task, rate: float) -> None:
        self.robot, self.bench, self.task, self.rate = robot, bench, task, rate
        self.reaches = [Reach(robot.model, arm) for arm in bench.arms]
        self.columns = [[robot.joint_index(name) for name in (*arm.joints, arm.gripper)] for arm in bench.arms]
        self.rest = np.zeros(len(robot.joints))
        for arm, columns in zip(bench.arms, self.columns, strict=True):
            self.rest[columns] = [*arm.home, arm.most]

    def begin(self, layout: Layout, seed: int = 0) -> None:
        """Look at the table and make a plan.

        Raises:
            EdreamError: a waypoint cannot be reached.
        """
        rng = np.random.default_rng(np.random.SeedSequence((seed, 0xE4)))
        self.arm, self.columns_now = layout.arm, self.columns[layout.arm]
        self.waypoints = self.task.waypoints(layout, self.bench.arms, rng)
        reach, q = self.reaches[self.arm], np.array(self.bench.arms[self.arm].home)
        pos, turn = reach.pose(q)
        self.goal = Waypoint(pos, turn, self.bench.arms[self.arm].most, 0.0)
        self.before, self.index, self.time, self.waited = self.goal, 0, 0.0, 0.0
        self.joints, self.off = q, np.zeros(len(q))
        self.past = [q] * (1 + round(SIGHT * self.rate))
        self.stances = [q]
        for number, one in enumerate(self.waypoints):
            self.stances.append(reachable(reach, one.pos, one.turn, self.stances[-1], f"waypoint {number} of {self.task.name}"))

    @property
    def done(self) -> bool:
        """Whether the plan has come to its end."""
        return self.index >= len(self.waypoints)

    def act(self, seen: Observation, hand: Hand | None = None) -> Float[np.ndarray, "A"]:
        """Commands for the next step; at the end of the plan the last ones are held.

        Args:
            seen: measured joints.
            hand: where the working hand is and its axes, if the expert can watch it; else it trusts the encoders.
        """
        if hand is None:
            lag = self.past[0] - seen.joints[self.columns_now[:-1]]
        else:
            pos, turn = self.reaches[self.arm].pose(self.past[0])
            lag = self.reaches[self.arm].towards(self.past[0], pos - hand[0], turn_between(hand[1], turn))
        self.off = np.clip(self.off + PULL / self.rate * lag, -FURTHEST, FURTHEST)
        self._advance(float(np.abs(lag).max()))
        goal = self.goal if self.done else self.waypoints[self.index]
        share = 1.0 if self.done or goal.seconds <= 0.0 else min(1.0, self.time / goal.seconds)
        eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)  # minimum jerk: Flash and Hogan, 1985
        self.joints = self._stance(goal, eased)
        self.past = [*self.past[1:], self.joints]
        command = self.rest.copy()
        command[self.columns_now[:-1]] = self.joints + self.off
        command[self.columns_now[-1]] = self.before.gap + eased * (goal.gap - self.before.gap)
        return command

    def _stance(self, goal: Waypoint, share: float) -> np.ndarray:
        """The hand on a straight line; where it turns far, each joint on its own way, so that no singularity catches it."""
        last, following = self.stances[self.index], self.stances[min(self.index + 1, len(self.stances) - 1)]
        nearby = last + share * (following - last)
        turn, angle = _between(self.before.turn, goal.turn, share)
        if angle > FAR:
            return nearby
        return self.reaches[self.arm].solve(self.before.pos + share * (goal.pos - self.before.pos), turn, nearby, 20)

    def _advance(self, lag: float) -> None:
        if self.done:
            return
        self.time += 1.0 / self.rate
        goal = self.waypoints[self.index]
        if self.time < goal.seconds - 1e-9:
            return
        if goal.exact and lag > NEAR and self.waited < PATIENCE:
            self.waited += 1.0 / self.rate
            return
        self.before = self.goal = goal
        self.index, self.time, self.waited = self.index + 1, 0.0, 0.0


def _between(one: np.ndarray, two: np.ndarray, share: float) -> tuple[np.ndarray, float]:
    """Axes on the shortest turn from one to another, and how far that is [rad]."""
    quat, turn, whole = np.zeros(4), np.zeros(3), np.zeros(9)
    mujoco.mju_mat2Quat(quat, (two @ one.T).ravel())
    mujoco.mju_quat2Vel(turn, quat, 1.0)
    angle = float(np.linalg.norm(turn))
    if angle < 1e-9:
        return one, 0.0
    mujoco.mju_axisAngle2Quat(quat, turn / angle, share * angle)
    mujoco.mju_quat2Mat(whole, quat)
    return whole.reshape(3, 3) @ one, angle
