"""How much torque a servo may give, and what of more its limit lets through. Written into emitted hook files as it stands."""

from typing import Any

import numpy as np


def limits_of(model: Any, ranges: Any) -> Any:
    """The least and the most that each servo gives [N m], (N, actuators, 2): its own limit, or its joint's where that is less.

    Args:
        model: the model.
        ranges: its `actuator_forcerange` [N m], (N, actuators, 2); counts where the model says that an actuator is limited.

    Source: MuJoCo XML reference, actuator/general/forcerange and body/joint/actuatorfrcrange.
    """
    limits = np.where(np.asarray(model.actuator_forcelimited, bool)[:, None], ranges, [-np.inf, np.inf])
    for actuator in range(model.nactuator):
        joint, gear = model.actuator_trnid[actuator, 0], abs(model.actuator_gear[actuator, 0])
        if model.actuator_trntype[actuator] in (0, 1) and model.jnt_actfrclimited[joint]:
            limits[:, actuator] = np.clip(limits[:, actuator], *(model.jnt_actfrcrange[joint] / gear))
    return limits


def let_through(state: Any, index: Any, more: Any) -> Any:
    """What gets through a position servo's limit of `more` torque than its law asks for [N m], (N,).

    The law is kp (u - q) - kv qd of the command u as it stands, without a delay, a lag or an integral that the servo may have.
    """
    actuator = index["actuator"]
    error = state.ctrl[:, index["ctrl"]] - state.qpos[:, index["drive_qpos"]]
    asked = state.gain[:, actuator] * error - state.speed_gain[:, actuator] * state.qvel[:, index["drive"]]
    low, high = state.limits[:, actuator, 0], state.limits[:, actuator, 1]
    return np.clip(asked + more, low, high) - np.clip(asked, low, high)
