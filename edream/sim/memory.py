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


def at_rest(dof: Any, seconds: Any) -> Any:
    """How fast a joint was before a recording that began at rest [rad/s]."""
    return 0.0
