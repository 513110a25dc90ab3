"""What hooks remember of a motion. Written into emitted hook files as it stands."""

from typing import Any

import numpy as np


def recent(state: Any, dof: Any, seconds: Any) -> Any:
    """How fast a joint has been lately [rad/s], (N,): its speed's size, averaged with weights exp(-age / seconds)."""
    now, before = float(state.time[0]), state.memory.get((dof, seconds))
    if before is None or before[0] != now:
        value = state.past(dof, seconds) if before is None else before[1]
        before = now, value + (np.abs(state.qvel[:, dof]) - value) * -np.expm1(-state.step / seconds)
        state.memory[dof, seconds] = before
    return before[1]


def loaded(state: Any, dof: Any, torque: Any) -> Any:
    """Which way a joint's gear last carried more than `torque` [N m], (N,): 1, or -1; 0 where it has not yet.

    A relay with hysteresis. Source: Preisach, Zeitschrift fuer Physik 94, 1935, which makes hysteresis of such relays.
    """
    load = state.gear_torque[:, dof]
    before = state.memory.get(("loaded", dof, torque), np.zeros(len(load)))
    side = np.where(load > torque, 1.0, np.where(load < -torque, -1.0, before))
    state.memory["loaded", dof, torque] = side
    return side
