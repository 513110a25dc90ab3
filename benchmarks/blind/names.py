"""The one place where the words and numbers of the make-believe robot meet those of the library."""

from collections.abc import Mapping

import mujoco
import numpy as np

from edream.core.effect import joint_index
from edream.core.errors import unknown_name
from edream.reality.truth import Hidden, Truth

SAME_NAME = frozenset(
    {
        "servo_gain",
        "viscous",
        "quadratic_drag",
        "coulomb",
        "asymmetric_coulomb",
        "stribeck",
        "load_friction",
        "directional_efficiency",
        "presliding",
        "position_friction",
        "hardening_spring",
        "constant_torque",
        "gravity_tilt",
        "payload",
        "armature",
        "backlash",
        "cogging",
        "slew_limit",
        "integral_action",
        "dead_zone",
        "actuator_delay",
        "actuator_lag",
        "sensor_delay",
        "encoder_offset",
        "gear_ratio",
        "joint_coupling",
    }
)
OTHER_NAME = {
    "parallel_spring": "spring",
    "joint_compliance": "compliance",
    "torque_saturation": "torque_limit",
    "torque_speed": "torque_speed_limit",
    "gain_drift": "gain_fade",
    "friction_drift": "friction_fade",
}
# quantity there -> quantity in the library, where one is the other times a factor
FACTORS: Mapping[str, Mapping[str, tuple[str, float]]] = {
    "quadratic_drag": {"coefficient": ("drag", 1.0)},
    "stribeck": {"torque": ("torque", 1.0), "velocity": ("speed", 1.0)},
    "load_friction": {"share": ("slope", 1.0)},
    "presliding": {"torque": ("torque", 1.0), "width": ("displacement", 1.0)},
    "parallel_spring": {"stiffness": ("stiffness", 1.0), "rest": ("reference", 1.0)},
    "hardening_spring": {"stiffness": ("stiffness", 1.0), "cubic": ("hardening", 1.0), "rest": ("reference", 1.0)},
    "constant_torque": {"torque": ("torque", 1.0)},
    "payload": {"mass": ("mass", 1.0)},
    "joint_compliance": {"compliance": ("give", 1.0)},
    "backlash": {"width": ("play", 0.5)},
    "cogging": {"torque": ("amplitude", 1.0), "count": ("periods", 1.0)},
    "torque_saturation": {"torque": ("torque", 1.0)},
    "torque_speed": {"torque": ("stall", 1.0), "velocity": ("speed", 1.0)},
    "slew_limit": {"rate": ("speed", 1.0)},
    "integral_action": {"gain": ("ki", 1.0)},
    "dead_zone": {"width": ("width", 1.0)},
    "actuator_delay": {"time": ("time", 1.0)},
    "actuator_lag": {"time": ("time", 1.0)},
    "sensor_delay": {"time": ("time", 1.0)},
    "encoder_offset": {"angle": ("angle", 1.0)},
    "gear_ratio": {"scale": ("encoder", 1.0)},
    "joint_coupling": {"stiffness": ("stiffness", -1.0)},
    "gain_drift": {"rate": ("rate", -1.0)},
    "friction_drift": {"rate": ("rate", -1.0)},
}


def library_name(hidden: str) -> str:
    """What the library calls a hidden effect.

    Raises:
        EdreamError: the library is not expected to have it.
    """
    if hidden in SAME_NAME:
        return hidden
    if hidden not in OTHER_NAME:
        raise unknown_name("effect that the library has", hidden, (*SAME_NAME, *OTHER_NAME))
    return OTHER_NAME[hidden]


def true_targets(hidden: Hidden, model: mujoco.MjModel) -> tuple[str, ...]:
    """The library's targets: "first<-second" for a coupling, the body that moves for one that is fixed to it."""
    if hidden.name == "joint_coupling":
        return ("<-".join(hidden.targets),)
    if hidden.name == "payload":
        return (model.body(int(model.body_weldid[model.body(hidden.targets[0]).id])).name,)
    return hidden.targets


def true_values(hidden: Hidden, truth: Truth, model: mujoco.MjModel) -> dict[str, float]:
    """The library's quantities at the truth; those that mean something else there are left out."""
    own = hidden.values
    if hidden.name in ("servo_gain", "viscous", "coulomb", "armature"):
        return _nuisance_value(hidden, truth)
    if hidden.name == "directional_efficiency":
        both = own["drive"] + own["back"]
        return {"slope": 0.5 * both, "asymmetry": (own["drive"] - own["back"]) / both}
    if hidden.name == "asymmetric_coulomb":  # friction against one way does not fall below zero
        mean, more = truth.nuisance["frictionloss"][hidden.targets[0]], own["torque"]
        forth, back = max(mean + more, 0.0), max(mean - more, 0.0)
        return {"asymmetry": (forth - back) / (forth + back)}
    if hidden.name == "gravity_tilt":
        return _tilt(own["roll"], own["pitch"], np.array(model.opt.gravity))
    factors = FACTORS.get(hidden.name, {})
    return {there: factor * own[here] for here, (there, factor) in factors.items()}


def _nuisance_value(hidden: Hidden, truth: Truth) -> dict[str, float]:
    joint = hidden.targets[0]
    true = {quantity: by_joint[joint] for quantity, by_joint in truth.nuisance.items()}
    if hidden.name == "servo_gain":
        return {"kp": true["kp"] * hidden.values["scale"]}
    if hidden.name == "viscous":
        return {"damping": true["damping"] + true["kd"] + hidden.values["coefficient"]}
    if hidden.name == "coulomb":
        return {"torque": true["frictionloss"] + hidden.values["torque"]}
    return {"inertia": true["armature"] + hidden.values["inertia"]}


def is_usual(hidden: Hidden, truth: Truth, model: mujoco.MjModel) -> bool:
    """Whether what is hidden leaves a usual number within 30 % of its published value, where no method can call it an effect."""
    if hidden.name not in ("servo_gain", "viscous", "coulomb", "armature"):
        return False
    index = joint_index(model, hidden.targets[0])
    kp, kd = -model.actuator_biasprm[index["actuator"], 1:3]
    published = {
        "kp": kp,
        "damping": model.dof_damping[index["dof"]] + kd,
        "torque": model.dof_frictionloss[index["dof"]],
        "inertia": model.dof_armature[index["dof"]],
    }
    return all(abs(value - published[name]) <= 0.3 * published[name] for name, value in _nuisance_value(hidden, truth).items())


def _tilt(roll: float, pitch: float, gravity: np.ndarray) -> dict[str, float]:
    """Angles a, b with Ry(b) Rx(a) g = (Ry(pitch) Rx(roll))^T g, for gravity straight down."""
    (sr, cr), (sp, cp) = ((np.sin(angle), np.cos(angle)) for angle in (roll, pitch))
    roll_matrix = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    pitch_matrix = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    down = (pitch_matrix @ roll_matrix).T @ gravity / np.linalg.norm(gravity)
    return {"about_x": float(np.arcsin(down[1])), "about_y": float(np.arctan2(-down[0], -down[2]))}
