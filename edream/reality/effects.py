"""Every hidden effect by name: where it may act, what it is worth when absent, and what is plausible and visible on a joint."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from edream.core.errors import unknown_name
from edream.reality import body_effects as body
from edream.reality import foreign_effects as foreign
from edream.reality import friction_effects as friction
from edream.reality import servo_effects as servo
from edream.reality.plant import Term

Draw = Callable[[np.random.Generator, "Scale"], dict[str, float]]


@dataclass(frozen=True)
class Scale:
    """What is small and large for one joint.

    Attributes:
        torque: a servo torque that shifts the joint by several encoder steps, and no servo's limit [N m].
        gravity: typical gravity torque [N m].
        inertia: inertia seen by the joint, armature included [kg m^2].
        kp: position gain of the nominal joint [N m/rad].
        damping: all damping of the nominal joint, the servo's included [N m s/rad].
        limit: largest torque of the nominal joint, infinite where there is none [N m].
        speed: a brisk speed [rad/s].
        span: a third of the joint's range [rad], centred at `middle`.
        middle: middle of the joint's range [rad].
        lever: distance at which the joint carries its weight [m].
        reach: how far from a body's origin a load may sit [m].
    """

    torque: float
    gravity: float
    inertia: float
    kp: float
    damping: float
    limit: float
    speed: float
    span: float
    middle: float
    lever: float
    reach: float = 0.06


@dataclass(frozen=True)
class Kind:
    """One sort of hidden effect.

    Attributes:
        term: what does it.
        where: "joint" (any), "loaded" (a joint that carries weight), "pair" (a joint and another), "body" or "base".
        absent: values at which it is not there.
        draw: plausible values that show.
        foreign: whether no library is expected to have it.
        changes: the nuisance parameters that it changes. Those of its target stay at their nominal values, and its own change is
            more than they may be off by; else the two might cancel, and nobody could call what is left an effect.
    """

    term: type[Term]
    where: Literal["joint", "loaded", "pair", "body", "base"]
    absent: Mapping[str, float]
    draw: Draw
    foreign: bool = False
    changes: tuple[str, ...] = ()


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _payload(rng: np.random.Generator, s: Scale) -> dict[str, float]:
    x, y, z = rng.uniform((0.5, -0.4, -1.0), (1.2, 0.4, 1.0)) * s.reach
    return {"mass": rng.uniform(0.5, 1.2) * s.torque / (9.81 * s.lever), "x": x, "y": y, "z": z}


def _place(rng: np.random.Generator, s: Scale, share: float = 0.6) -> float:
    return s.middle + share * s.span * rng.uniform(-1.0, 1.0)


KINDS: Mapping[str, Kind] = {
    "servo_gain": Kind(servo.ServoGain, "loaded", {"scale": 1.0}, lambda r, s: {"scale": r.uniform(0.5, 0.65)}, changes=("kp",)),
    "viscous": Kind(
        friction.Viscous,
        "joint",
        {"coefficient": 0.0},
        lambda r, s: {"coefficient": r.uniform(1, 2) * max(s.torque / s.speed, 0.6 * s.damping)},
        changes=("kd", "damping"),
    ),
    "quadratic_drag": Kind(
        friction.QuadraticDrag,
        "joint",
        {"coefficient": 0.0},
        lambda r, s: {"coefficient": r.uniform(1.5, 3) * s.torque / s.speed**2},
    ),
    "coulomb": Kind(
        friction.Coulomb,
        "joint",
        {"torque": 0.0},
        lambda r, s: {"torque": r.uniform(0.8, 1.6) * s.torque},
        changes=("frictionloss",),
    ),
    "asymmetric_coulomb": Kind(
        friction.AsymmetricCoulomb, "joint", {"torque": 0.0}, lambda r, s: {"torque": _sign(r) * r.uniform(0.7, 1.3) * s.torque}
    ),
    "stribeck": Kind(
        friction.Stribeck,
        "joint",
        {"torque": 0.0, "velocity": 0.1},
        lambda r, s: {"torque": r.uniform(1.0, 2.0) * s.torque, "velocity": r.uniform(0.08, 0.2) * s.speed},
    ),
    "load_friction": Kind(friction.LoadFriction, "loaded", {"share": 0.0}, lambda r, s: {"share": r.uniform(0.15, 0.35)}),
    "directional_efficiency": Kind(
        friction.DirectionalEfficiency,
        "loaded",
        {"drive": 0.0, "back": 0.0},
        lambda r, s: {"drive": r.uniform(0.25, 0.45), "back": r.uniform(0.02, 0.08)},
    ),
    "presliding": Kind(
        friction.Presliding,
        "joint",
        {"torque": 0.0, "width": 0.01},
        lambda r, s: {"torque": r.uniform(1.0, 2.0) * s.torque, "width": r.uniform(0.03, 0.08) * s.span},
    ),
    "position_friction": Kind(
        friction.PositionFriction,
        "joint",
        {"torque": 0.0, "centre": 0.0, "width": 1.0},
        lambda r, s: {"torque": r.uniform(1.5, 3.0) * s.torque, "centre": _place(r, s), "width": r.uniform(0.25, 0.5) * s.span},
    ),
    "parallel_spring": Kind(
        body.ParallelSpring,
        "joint",
        {"stiffness": 0.0, "cubic": 0.0, "rest": 0.0},
        lambda r, s: {"stiffness": r.uniform(1.5, 3) * s.torque / s.span, "cubic": 0.0, "rest": _place(r, s)},
    ),
    "hardening_spring": Kind(
        body.ParallelSpring,
        "joint",
        {"stiffness": 0.0, "cubic": 0.0, "rest": 0.0},
        lambda r, s: {
            "stiffness": 0.5 * s.torque / s.span,
            "cubic": r.uniform(1.5, 3) * s.torque / s.span**3,
            "rest": _place(r, s, 0.3),
        },
    ),
    "constant_torque": Kind(
        body.ConstantTorque, "joint", {"torque": 0.0}, lambda r, s: {"torque": _sign(r) * r.uniform(0.8, 1.6) * s.torque}
    ),
    "gravity_tilt": Kind(
        body.GravityTilt,
        "base",
        {"roll": 0.0, "pitch": 0.0},
        lambda r, s: {"roll": _sign(r) * r.uniform(0.08, 0.2), "pitch": _sign(r) * r.uniform(0.08, 0.2)},
    ),
    "payload": Kind(body.Payload, "body", {"mass": 0.0, "x": 0.0, "y": 0.0, "z": 0.0}, _payload),
    "armature": Kind(
        body.Armature, "joint", {"inertia": 0.0}, lambda r, s: {"inertia": r.uniform(0.7, 1.5) * s.inertia}, changes=("armature",)
    ),
    "joint_compliance": Kind(
        body.JointCompliance, "loaded", {"compliance": 0.0}, lambda r, s: {"compliance": r.uniform(0.4, 0.65) / s.kp}
    ),
    "backlash": Kind(body.Backlash, "joint", {"width": 0.0}, lambda r, s: {"width": r.uniform(0.015, 0.035) * min(s.span, 1.0)}),
    "cogging": Kind(
        body.Cogging,
        "joint",
        {"torque": 0.0, "count": 20.0, "phase": 0.0},
        lambda r, s: {
            "torque": r.uniform(0.8, 1.6) * s.torque,
            "count": float(r.integers(8, 30)) / min(s.span, 1.0),
            "phase": r.uniform(-np.pi, np.pi),
        },
    ),
    "torque_saturation": Kind(
        servo.TorqueSaturation,
        "loaded",
        {"torque": np.inf},
        lambda r, s: {"torque": min(r.uniform(1.4, 1.8) * (s.gravity + s.torque), r.uniform(0.4, 0.6) * s.limit)},
    ),
    "torque_speed": Kind(
        servo.TorqueSpeed,
        "loaded",
        {"torque": np.inf, "velocity": np.inf},
        lambda r, s: {
            "torque": min(r.uniform(2.0, 3.0) * (s.gravity + s.torque), r.uniform(0.6, 0.9) * s.limit),
            "velocity": r.uniform(1.0, 1.5) * s.speed,
        },
    ),
    "slew_limit": Kind(servo.SlewLimit, "joint", {"rate": np.inf}, lambda r, s: {"rate": r.uniform(0.5, 0.9) * s.speed}),
    "integral_action": Kind(servo.IntegralAction, "loaded", {"gain": 0.0}, lambda r, s: {"gain": r.uniform(0.5, 1.5) * s.kp}),
    "dead_zone": Kind(servo.DeadZone, "joint", {"width": 0.0}, lambda r, s: {"width": r.uniform(0.01, 0.02) * min(s.span, 1.0)}),
    "actuator_delay": Kind(servo.ActuatorDelay, "joint", {"time": 0.0}, lambda r, s: {"time": r.uniform(0.015, 0.045)}),
    "actuator_lag": Kind(servo.ActuatorLag, "joint", {"time": 0.0}, lambda r, s: {"time": r.uniform(0.03, 0.08)}),
    "sensor_delay": Kind(servo.SensorDelay, "joint", {"time": 0.0}, lambda r, s: {"time": r.uniform(0.015, 0.035)}),
    "encoder_offset": Kind(servo.EncoderOffset, "loaded", {"angle": 0.0}, lambda r, s: {"angle": _sign(r) * r.uniform(0.12, 0.25)}),
    "gear_ratio": Kind(servo.GearRatio, "loaded", {"scale": 1.0}, lambda r, s: {"scale": 1.0 + _sign(r) * r.uniform(0.06, 0.12)}),
    "joint_coupling": Kind(
        body.JointCoupling,
        "pair",
        {"stiffness": 0.0, "damping": 0.0},
        lambda r, s: {"stiffness": _sign(r) * r.uniform(1, 2) * s.torque / 0.8, "damping": 0.0},
    ),
    "gain_drift": Kind(servo.GainDrift, "loaded", {"rate": 0.0}, lambda r, s: {"rate": -r.uniform(0.02, 0.045)}),
    "friction_drift": Kind(friction.FrictionDrift, "joint", {"rate": 0.0}, lambda r, s: {"rate": r.uniform(0.15, 0.4)}),
    "cable_snag": Kind(
        foreign.CableSnag,
        "joint",
        {"torque": 0.0, "start": 0.0, "length": 0.3},
        lambda r, s: {"torque": r.uniform(3, 5) * s.torque, "start": _place(r, s, 0.4), "length": r.uniform(0.4, 0.8) * s.span},
        foreign=True,
    ),
    "warm_stick": Kind(
        foreign.WarmStick,
        "joint",
        {"torque": 0.0, "energy": 1.0, "cooling": 1.0},
        lambda r, s: {
            "torque": r.uniform(2.5, 4) * s.torque,
            "energy": r.uniform(0.7, 1.5) * s.torque * s.span,
            "cooling": r.uniform(1.5, 3.0),
        },
        foreign=True,
    ),
    "detent": Kind(
        foreign.Detent,
        "joint",
        {"torque": 0.0, "first": 0.0, "second": 0.5, "width": 0.1},
        lambda r, s: {
            "torque": r.uniform(2, 3.5) * s.torque,
            "first": s.middle - r.uniform(0.2, 0.7) * s.span,
            "second": s.middle + r.uniform(0.2, 0.7) * s.span,
            "width": r.uniform(0.08, 0.15) * s.span,
        },
        foreign=True,
    ),
    "commutation_ripple": Kind(
        foreign.CommutationRipple,
        "joint",
        {"coefficient": 0.0, "count": 6.0},
        lambda r, s: {"coefficient": r.uniform(4, 7) * s.torque / s.speed, "count": r.uniform(2.0, 4.0) / min(s.span, 1.0)},
        foreign=True,
    ),
    "product_drag": Kind(
        foreign.ProductDrag,
        "pair",
        {"coefficient": 0.0},
        lambda r, s: {"coefficient": r.uniform(6, 12) * s.torque / s.speed},
        foreign=True,
    ),
    "belt_slip": Kind(
        foreign.BeltSlip,
        "loaded",
        {"jump": 0.0, "torque": 1.0},
        lambda r, s: {"jump": _sign(r) * r.uniform(0.012, 0.025), "torque": r.uniform(0.4, 0.7) * (s.gravity + s.torque)},
        foreign=True,
    ),
    "rubber_stop": Kind(
        foreign.RubberStop,
        "joint",
        {"stiffness": 0.0, "start": 0.0},
        lambda r, s: {"stiffness": r.uniform(20, 35) * s.torque / s.span**2, "start": s.middle + r.uniform(-0.2, 0.2) * s.span},
        foreign=True,
    ),
}


def kind(name: str) -> Kind:
    """The hidden effect of this name.

    Raises:
        EdreamError: there is none.
    """
    if name not in KINDS:
        raise unknown_name("hidden effect", name, KINDS)
    return KINDS[name]
