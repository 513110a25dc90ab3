"""Dry friction that holds, which MuJoCo's default does not, or that lets a stuck joint creep as fast as it is told to."""

from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.effect import Fields

IMPEDANCE = 0.9999


def hold_still(spec: mujoco.MjSpec, joint: str) -> None:
    """Make a joint's dry friction hold, so that a stuck joint stays where it stopped.

    `frictionloss` is a soft constraint. With MuJoCo's defaults (impedance 0.9 to 0.95, time constant 0.02 s) a joint held against
    an acceleration a0 creeps at about 0.1 a0 x 0.01 s: 6 mrad/s for an arm joint that gravity pulls at 6 rad/s^2, which over a
    long hold is larger than most effects. Two steps and an impedance of 0.9999 bring it to microradians a second. Writes
    `solreffriction` and `solimpfriction`. Source: MuJoCo computation chapter, constraint parameters (solimp, solref).
    """
    found = spec.joint(joint)
    found.solref_friction = [2.0 * spec.option.timestep, 1.0]
    found.solimp_friction = [IMPEDANCE, IMPEDANCE, 0.001, 0.5, 2.0]


def let_creep(fields: Fields, dof: int, torque: Float[np.ndarray, "N"], speed: Float[np.ndarray, "N"], impedance: float) -> None:
    """Let dry friction [N m] of a degree of freedom hold a load in proportion to speed until it is whole at `speed` [rad/s].

        tau = -F clip(qd / speed, -1, 1)

    A constraint of impedance d and time constant T acts on slow speeds as a damping of 2 / ((1 - d) T w), with w the inverse of the
    inertia that the joint moves. `impedance` is the least d: a small one stops a joint at once, as a smooth law of friction does;
    one near 1 takes T for it, as MuJoCo's defaults do. Writes `solreffriction` and `solimpfriction`. Source: as `hold_still`.
    """
    steps = 2.0 * fields.model.opt.timestep
    soft = 2.0 * speed / (np.maximum(torque, 1e-9) * fields.model.dof_invweight0[dof])  # (1 - d) T
    give = np.clip(soft / steps, 1.0 - IMPEDANCE, 1.0 - impedance)
    fields["dof_solimp"][:, dof, 0] = fields["dof_solimp"][:, dof, 1] = 1.0 - give
    fields["dof_solref"][:, dof, 0] = np.maximum(steps, soft / give)


def way(state: Any, dof: Any) -> Any:
    """Which way a joint goes, or dry friction holds it from going, (N,): 1, -1, or 0 where nothing moves or pulls it.

    Slower than 1e-3 rad/s it is the way against the constraint's force in the last step, since the speed of a held joint is none
    that counts. Written into emitted hook files as it stands.
    """
    speed = state.qvel[:, dof]
    return np.sign(np.where(abs(speed) > 1e-3, speed, -state.constraint[:, dof]))
