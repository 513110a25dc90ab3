"""Does each parameter move the robot at all? One that is silently not applied is the commonest bug of this field."""

import numpy as np

from edream.core.errors import EdreamError
from edream.sim.objective import Objective


def check_moves(objective: Objective) -> None:
    """Try every parameter at both ends of its box.

    Raises:
        EdreamError: naming a parameter that changes no simulated position.
    """
    space = objective.simulated.space
    start = np.clip(space.to_unit(space.start()), 0.02, 0.98)
    tried = np.repeat(start[None], 1 + 2 * len(space), axis=0)
    for i in range(len(space)):
        tried[1 + 2 * i, i], tried[2 + 2 * i, i] = 0.02, 0.98
    residuals = objective.residuals(space.from_unit(tried))
    for i, (name, parameter) in enumerate(zip(space.names, space.parameters, strict=True)):
        if np.array_equal(residuals[0], residuals[1 + 2 * i]) and np.array_equal(residuals[0], residuals[2 + 2 * i]):
            raise EdreamError(
                f"Parameter {name!r} moves nothing: from {parameter.low:g} to {parameter.high:g} {parameter.unit} no simulated position "
                "of a joint that counts changes. Remove it from fit.effects, or record motions that need it."
            )
