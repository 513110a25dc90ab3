"""Dry friction that holds: MuJoCo's default lets a stuck joint creep."""

import mujoco

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
