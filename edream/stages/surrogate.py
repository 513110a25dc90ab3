"""Surrogate: learn the simulator from a sweep, and say how well on parameter sets that it was not shown."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from edream import catalog
from edream.calibration.surrogate import Surrogate
from edream.calibration.sweeping import from_tables
from edream.core.stage import Artifact, Bundle, Stage, Work

WEIGHTS = "weights.safetensors"
HELD_OUT = 7  # every seventh parameter set judges


@dataclass(frozen=True)
class SurrogateSettings:
    """Which surrogate, and its options as the catalog entry names them."""

    kind: str = "mlp"
    options: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class SurrogateConfig:
    """What surrogate reads."""

    surrogate: SurrogateSettings


def run(inputs: Mapping[str, Artifact], config: SurrogateConfig, work: Work) -> Bundle:
    """Learn from six sevenths of the parameter sets; judge on the rest."""
    sweep = from_tables(inputs["sweep"])
    entry = catalog.load("surrogates", config.surrogate.kind, Surrogate)
    judging = sweep.which[:, 0] % HELD_OUT == HELD_OUT - 1

    def learn(item: Any, rng: np.random.Generator) -> Bundle:
        return {
            WEIGHTS: dict(entry.fit(sweep.take(np.flatnonzero(~judging)), config.surrogate.options, work.seed("learn")).weights())
        }

    weights = work.shards("learned", [0], learn, parallel=False)[0][WEIGHTS]
    learned = entry.load(weights)
    errors = {
        "train": learned.errors(sweep.take(np.flatnonzero(~judging))),
        "heldout": learned.errors(sweep.take(np.flatnonzero(judging))),
    }
    held = errors["heldout"]
    sentence = (
        f"The surrogate is off by {held['one_step_rad']:.2g} rad after one step and {held['window_rad']:.2g} rad over "
        f"{held['window_rows']:.0f} steps on parameter sets that it was not shown."
    )
    return {WEIGHTS: weights, "summary.json": {"sentence": sentence, "kind": config.surrogate.kind, "error": errors}}


ENTRY = Stage(name="surrogate", version=1, needs=("sweep",), config=SurrogateConfig, run=run, numerics=("torch",))
