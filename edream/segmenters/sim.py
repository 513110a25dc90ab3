"""Objects where the simulated ones are: the masks of the rendering."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from edream.core.errors import EdreamError
from edream.core.segmenter import Footage, Masks, Segmenter


class Simulated(Segmenter):
    """The simulated objects' own masks; as good as the tracked poses and shapes in `render.scene` are."""

    name = "sim"
    summary = "masks of the simulated objects; needs render.scene"

    def masks(self, footage: Footage, options: Mapping[str, Any]) -> Masks:
        if not footage.simulated.any():
            raise EdreamError(
                f"Episode {footage.name!r} has no simulated object; masks.segmenter=sim needs render.scene with its tracks."
            )
        return (footage.simulated > 127).astype(np.uint8)


ENTRY = Simulated()
