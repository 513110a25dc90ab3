"""Whose eyes a policy has in a simulated workcell, as something that other processes can open."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from edream.learn.checkpoint import read_weights
from edream.practice.rehearsing import RolloutOptions, open_composite, open_raw, plate_image
from edream.practice.trial import Eyes, OwnEyes
from edream.practice.worlds import DreamedEyes
from edream.vision.dreamer import Dreamer
from edream.vision.grain import Grain
from edream.vision.trained import CODEC, file_of, loaded
from edream.vision.variants import DREAM, DreamOptions, variants


@dataclass(frozen=True, eq=False)
class Dreaming:
    """A trained dream model as it can be sent to another process.

    Attributes:
        files: file name -> where its weights lie.
        options: as it was trained.
        plate: the background, (H, W, 3).
        grain: sensor noise that is put back, by brightness.
        seed: of the model's noise.
    """

    files: Mapping[str, Path]
    options: DreamOptions
    plate: np.ndarray
    grain: tuple[float, ...]
    seed: int


def open_dreamed(dreaming: Dreaming) -> DreamedEyes:
    """Load the model."""
    trained = {name: {key: value.numpy() for key, value in read_weights(path).items()} for name, path in dreaming.files.items()}
    variant = next(one for one in variants(dreaming.options, ()) if one.name == DREAM)
    model = loaded(trained, dreaming.options, variant, dreaming.seed)
    return DreamedEyes(Dreamer(model, dreaming.plate, Grain(dreaming.grain), dreaming.seed))


def eyes_of(options: RolloutOptions, inputs: Mapping[str, Any], dream: DreamOptions, seed: int) -> Callable[[], Eyes]:
    """What opens the eyes that the config names."""
    if options.eyes == "state":
        return OwnEyes
    if options.eyes == "raw":
        return open_raw
    if options.eyes == "composite":
        return partial(open_composite, plate_image(inputs, options))
    made = inputs["dream"]
    files = {name: made.path(name) for name in (file_of(DREAM), CODEC) if name in made}
    grain = tuple(made["grain.json"][DREAM])
    return partial(open_dreamed, Dreaming(files, dream, plate_image(inputs, options), grain, seed))
