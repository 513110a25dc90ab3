"""Which motions teach and which only judge. A motion is never on both sides."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

import numpy as np

from edream.calibration.settings import SpaceSettings
from edream.core.episode import Episode
from edream.core.errors import EdreamError, unknown_name


def split_motions(episodes: Sequence[Episode], settings: SpaceSettings, seed: int) -> tuple[list[Episode], list[Episode]]:
    """Training and held-out motions, each in the order given.

    Drawn by name and seed alone, so neither the order nor the number of other settings changes who is held out.

    Raises:
        EdreamError: a name of `holdout` matches no motion, or nothing is left to fit on.
    """
    names = [episode.name for episode in episodes]
    if settings.holdout:
        for pattern in settings.holdout:
            if not any(fnmatchcase(name, pattern) for name in names):
                raise unknown_name("motion for fit.holdout", pattern, names)
        held = {name for name in names if any(fnmatchcase(name, pattern) for pattern in settings.holdout)}
    else:
        if not 0.0 <= settings.holdout_fraction < 1.0:
            raise EdreamError(f"fit.holdout_fraction is {settings.holdout_fraction}; expected 0 or more and below 1.")
        count = round(settings.holdout_fraction * len(names))
        count = max(1, count) if settings.holdout_fraction > 0.0 and len(names) > 1 else count
        held = {str(name) for name in np.random.default_rng(seed).permutation(sorted(names))[:count]}
    train = [episode for episode in episodes if episode.name not in held]
    if not train:
        raise EdreamError(f"All {len(names)} motions are held out; expected at least one to fit on.")
    return train, [episode for episode in episodes if episode.name in held]
