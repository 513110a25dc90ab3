"""Rigid-body dynamics of a tree of hinge and slide joints, for many motions at once.

Written with 4 x 4 matrices in the world frame: link k at pose X_k has the pseudo-inertia J_k = X_k P_k X_k^T, joint i has the twist
S_i (a 4 x 4 matrix), and with V, A the cumulated twists and their rates

    M_ij  = tr(S_i (sum_k J_k) S_j^T)                 k below both joints
    bias_i = tr(S_i sum_k J_k (A_k + V_k^2 + G)^T)    k below i; G is minus gravity, as a twist rate

Source: Wittenburg, Dynamics of Multibody Systems; Legnani et al., Mechanism and Machine Theory 31(5), 1996.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.errors import EdreamError

HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
SLIDE = int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True, eq=False)
class Tree:
    """Geometry and inertia of a robot, one link for each joint.

    Attributes:
        parent: link that carries each joint, -1 for the ground, (J,).
        carrier: link that each body of the model moves with, -1 for the ground, with the body's pose in it, (B,) and (B, 4, 4).
        pose: constant, sine, one-minus-cosine and displacement parts of each link's pose in its parent, (J, 4, 16).
        twist: each joint's twist in its own link's frame, (J, 4, 4).
        inertia: pseudo-inertia of each link in its own frame, (J, 4, 4).
        below: 1 where link k hangs below joint i, (J, J).
        reference: joint positions at which the model was drawn, (J,).
    """

    parent: tuple[int, ...]
    carrier: tuple[tuple[int, np.ndarray], ...]
    pose: Float[np.ndarray, "J 4 16"]
    twist: Float[np.ndarray, "J 4 4"]
    inertia: Float[np.ndarray, "J 4 4"]
    below: Float[np.ndarray, "J J"]
    reference: Float[np.ndarray, "J"]
    is_slide: np.ndarray

    def poses(self, q: Float[np.ndarray, "M J"]) -> Float[np.ndarray, "J M 4 4"]:
        """Pose of every link in the world."""
        joints, motions = len(self.parent), len(q)
        s = (q - self.reference).T
        basis = np.empty((joints, motions, 4))
        basis[..., 0] = 1.0
        basis[..., 1] = np.sin(s)
        basis[..., 2] = 1.0 - np.cos(s)
        basis[..., 3] = s
        world = (basis @ self.pose).reshape(joints, motions, 4, 4)
        for link, carrier in enumerate(self.parent):
            if carrier >= 0:
                world[link] = world[carrier] @ world[link]
        return world

    def terms(
        self, q: Float[np.ndarray, "M J"], v: Float[np.ndarray, "M J"], gravity: Float[np.ndarray, "3"]
    ) -> tuple[Float[np.ndarray, "M J J"], Float[np.ndarray, "M J"]]:
        """Mass matrix without armature, and the torque that holds the robot at zero joint acceleration."""
        joints, motions = len(self.parent), len(q)
        x = self.poses(q)
        s = x @ self.twist[:, None] @ _inverse(x)
        j = x @ self.inertia[:, None] @ x.swapaxes(-1, -2)
        above = self.below.T
        sv = s * v.T[..., None, None]
        velocity = (above @ sv.reshape(joints, -1)).reshape(sv.shape)
        rate = velocity @ sv
        rate -= sv @ velocity
        acceleration = (above @ rate.reshape(joints, -1)).reshape(sv.shape)
        acceleration += velocity @ velocity
        acceleration[..., :3, 3] -= gravity
        stacked = np.concatenate([j @ acceleration.swapaxes(-1, -2), j], axis=1).reshape(joints, -1)
        composite = (self.below @ stacked).reshape(joints, 2 * motions, 4, 4)
        bias = np.einsum("jmab,jmba->mj", s, composite[:, :motions])
        flat = s.reshape(joints, motions, 16).transpose(1, 0, 2)
        momentum = (s @ composite[:, motions:]).reshape(joints, motions, 16).transpose(1, 2, 0)
        pairs = (flat @ momentum) * self.below
        diagonal = pairs.diagonal(axis1=1, axis2=2)
        mass = pairs + pairs.swapaxes(1, 2)
        mass[:, np.arange(joints), np.arange(joints)] -= diagonal
        return mass, bias

    def with_mass(self, body: int, mass: float, centre: Float[np.ndarray, "3"]) -> "Tree":
        """The same tree with a point mass [kg] fixed to a body of the model at `centre` [m] in that body's frame."""
        link, pose = self.carrier[body]
        if link < 0:
            raise EdreamError(f"A payload on body {body} moves nothing: no joint carries it.")
        point = pose @ np.append(centre, 1.0)
        inertia = self.inertia.copy()
        inertia[link] += mass * np.outer(point, point)
        return Tree(self.parent, self.carrier, self.pose, self.twist, inertia, self.below, self.reference, self.is_slide)


def tree_of(model: mujoco.MjModel) -> Tree:
    """Read geometry and inertia from a compiled model.

    Raises:
        EdreamError: the model has ball or free joints, or joints held together by an equality.
    """
    if model.neq or model.njnt != model.nv or not set(model.jnt_type.tolist()) <= {HINGE, SLIDE}:
        raise EdreamError("The make-believe robot needs hinge and slide joints only, with no equality between them.")
    parent: list[int] = []
    poses, twists = [], []
    carrier: list[tuple[int, np.ndarray]] = [(-1, np.eye(4))]
    inertia = np.zeros((model.nv, 4, 4))
    for body in range(1, model.nbody):
        link, offset = carrier[model.body_parentid[body]]
        offset = offset @ _pose(model.body_pos[body], model.body_quat[body])
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            parent.append(link)
            twist = _twist(int(model.jnt_type[joint]), model.jnt_axis[joint], model.jnt_pos[joint])
            twists.append(twist)
            poses.append([(offset @ part).ravel() for part in _exponential(twist, int(model.jnt_type[joint]))])
            link, offset = joint, np.eye(4)
        carrier.append((link, offset))
        if link >= 0:
            inertia[link] += offset @ _pseudo_inertia(model, body) @ offset.T
    below = np.eye(model.nv)
    for link in range(model.nv):
        ancestor = parent[link]
        while ancestor >= 0:
            below[ancestor, link] = 1.0
            ancestor = parent[ancestor]
    is_slide = np.asarray(model.jnt_type) == SLIDE
    return Tree(tuple(parent), tuple(carrier), np.array(poses), np.array(twists), inertia, below, model.qpos0.copy(), is_slide)


def _pseudo_inertia(model: mujoco.MjModel, body: int) -> np.ndarray:
    frame = _pose(model.body_ipos[body], model.body_iquat[body])
    moments = model.body_inertia[body]
    second = np.diag(np.append(0.5 * moments.sum() - moments, model.body_mass[body]))
    return frame @ second @ frame.T


def _pose(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = position
    return pose


def _twist(kind: int, axis: np.ndarray, anchor: np.ndarray) -> np.ndarray:
    twist = np.zeros((4, 4))
    if kind == SLIDE:
        twist[:3, 3] = axis
    else:
        twist[:3, :3] = [[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]]
        twist[:3, 3] = -twist[:3, :3] @ anchor
    return twist


def _exponential(twist: np.ndarray, kind: int) -> tuple[np.ndarray, ...]:
    """exp(twist s) as constant, sine, one-minus-cosine and displacement parts."""
    nothing = np.zeros((4, 4))
    return (np.eye(4), nothing, nothing, twist) if kind == SLIDE else (np.eye(4), twist, twist @ twist, nothing)


def _inverse(x: np.ndarray) -> np.ndarray:
    inverse = np.zeros_like(x)
    rotation = x[..., :3, :3].swapaxes(-1, -2)
    inverse[..., :3, :3] = rotation
    inverse[..., :3, 3:] = -rotation @ x[..., :3, 3:]
    inverse[..., 3, 3] = 1.0
    return inverse
