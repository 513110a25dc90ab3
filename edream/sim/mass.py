"""Point masses on links: what a payload is, and a known weight that the hand held while it was recorded."""

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.effect import Fields
from edream.core.errors import EdreamError
from edream.sim.robot import RobotModel

HAND_WEIGHT = "hand_weight"  # the condition of a recording: kg held in the hand
LEAST = 1e-9  # kg m^2


def add_mass(fields: Fields, body: int, mass: Float[np.ndarray, "N"], point: Float[np.ndarray, "N 3"]) -> None:
    """Put a point mass [kg], which may be negative, on a body at a point [m] in its frame, beside what was written there before."""
    there = np.flatnonzero(mass != 0.0)
    if not len(there):
        return
    own, centre = fields["body_mass"][there, body].copy(), fields["body_ipos"][there, body].copy()
    frames = np.array([_matrix(one) for one in fields["body_iquat"][there, body]])
    total = own + mass[there]
    joint = (own[:, None] * centre + mass[there, None] * point[there]) / total[:, None]
    inertia = np.einsum("nij,nj,nkj->nik", frames, fields["body_inertia"][there, body], frames)
    inertia += own[:, None, None] * _about(centre - joint) + mass[there, None, None] * _about(point[there] - joint)
    principal, axes = np.linalg.eigh(inertia)
    # what is taken away may be more than was there: some mass is left along each axis, as every body has it
    spread = np.maximum(0.5 * principal.sum(axis=1, keepdims=True) - principal, LEAST)
    axes[np.linalg.det(axes) < 0.0, :, 2] *= -1.0
    fields["body_mass"][there, body] = total
    fields["body_ipos"][there, body] = joint
    fields["body_inertia"][there, body] = spread.sum(axis=1, keepdims=True) - spread
    turns = fields["body_iquat"]
    for row, frame in zip(there, axes, strict=True):
        mujoco.mju_mat2Quat(turns[row, body], np.ascontiguousarray(frame).ravel())


def hold_weights(fields: Fields, robot: RobotModel, weights: Float[np.ndarray, "N"]) -> None:
    """Put the weight [kg] that each recording says the hand held into its simulation, at the end effector.

    Raises:
        EdreamError: a weight is less than nothing, or some weigh anything and the body at the end has no name.
    """
    if weights.min(initial=0.0) < 0.0:
        raise EdreamError(f"A recording notes {HAND_WEIGHT} = {weights.min():g} in conditions.csv; expected 0 kg or more.")
    if not weights.any():
        return
    body, point = hand_of(robot)
    if not (name := robot.model.body(body).name):
        raise EdreamError(
            f"A recording notes {HAND_WEIGHT} in conditions.csv, but the last body of robot {robot.name!r} has no name; "
            "name it, or choose a site on another with robot.site."
        )
    add_mass(fields, fields.model.body(name).id, weights, np.tile(point, (len(weights), 1)))


def hand_of(robot: RobotModel) -> tuple[int, Float[np.ndarray, "3"]]:
    """The body at the end of a robot, and the point [m] in its frame where a weight is held.

    That of the end-effector site; without one, the end of the longest chain: its first site, or its centre of mass.
    """
    model = robot.model
    if robot.site:
        site = model.site(robot.site).id
        return int(model.site_bodyid[site]), model.site_pos[site].copy()
    body = last_body(model)
    sites = np.flatnonzero(model.site_bodyid == body)
    return body, (model.site_pos[sites[0]] if len(sites) else model.body_ipos[body]).copy()


def last_body(model: mujoco.MjModel) -> int:
    """The body at the end of the longest chain of bodies; the first of equals."""
    depth = np.zeros(model.nbody, int)
    for body in range(1, model.nbody):
        depth[body] = depth[model.body_parentid[body]] + 1
    return int(np.argmax(depth))


def _matrix(turn: Float[np.ndarray, "4"]) -> Float[np.ndarray, "3 3"]:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, turn)
    return out.reshape(3, 3)


def _about(offset: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3 3"]:
    """Inertia of a unit mass at an offset [m^2]."""
    square = (offset**2).sum(axis=1)
    return square[:, None, None] * np.eye(3) - offset[:, :, None] * offset[:, None, :]
