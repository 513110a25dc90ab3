"""Does each parameter move the robot at all? One that is silently not applied is the commonest bug of this field."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from edream.core.errors import EdreamError
from edream.sim.objective import Objective

ENOUGH = 6  # windows; only what stands still there is tried on all


def check_moves(objective: Objective) -> None:
    """Try every parameter at both ends of its box.

    One that changes nothing is passed over where another of the same effect and place does: which share of a damping lies within a
    torque limit tells only where the limit is reached.

    Raises:
        EdreamError: naming a parameter that changes no simulated position.
    """
    space = objective.simulated.space
    few = objective.windows[:: max(1, len(objective.windows) // ENOUGH)]
    still = standing_still(replace(objective, windows=few), range(len(space)))
    if still and len(few) < len(objective.windows):
        still = standing_still(objective, still)
    moving = {effect_at(name) for n, name in enumerate(space.names) if n not in still}
    still = [n for n in still if effect_at(space.names[n]) not in moving]
    if still:
        parameter = space.parameters[still[0]]
        raise EdreamError(
            f"Parameter {parameter.name!r} moves nothing: from {parameter.low:g} to {parameter.high:g} {parameter.unit} no "
            "simulated position of a joint that counts changes. Remove it from fit.effects, or record motions that need it."
        )


def effect_at(name: str) -> tuple[str, str]:
    """Effect and place of a parameter: `coulomb.torque[pan]` -> ("coulomb", "pan")."""
    effect, _, rest = name.partition(".")
    return effect, rest.partition("[")[2].removesuffix("]")


def standing_still(objective: Objective, numbers: Sequence[int]) -> list[int]:
    """Of some parameters, those that change no residual at either end of their box."""
    space = objective.simulated.space
    tried = np.repeat(np.clip(space.to_unit(space.start()), 0.02, 0.98)[None], 1 + 2 * len(numbers), axis=0)
    for row, number in enumerate(numbers):
        tried[1 + 2 * row, number], tried[2 + 2 * row, number] = 0.02, 0.98
    moved = objective.residuals(space.from_unit(tried))
    return [
        n
        for row, n in enumerate(numbers)
        if np.array_equal(moved[0], moved[1 + 2 * row]) and np.array_equal(moved[0], moved[2 + 2 * row])
    ]
