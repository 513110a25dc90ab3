"""Films of trials as moving pictures that a page can hold."""

import io
from collections.abc import Mapping, Sequence

import numpy as np
from PIL import Image

MOST = 60  # images of a film


def strip_of(film: Sequence[Mapping[str, np.ndarray]], rate: float) -> bytes:
    """A moving picture (animated PNG) of all cameras beside one another, thinned to at most `MOST` images, at its true speed."""
    apart = max(1, -(-len(film) // MOST))
    rows = [np.concatenate(list(images.values()), axis=1) for images in film[::apart] if images]
    if not rows:
        return b""
    pictures = [Image.fromarray(row) for row in rows]
    out = io.BytesIO()
    pictures[0].save(out, "PNG", save_all=True, append_images=pictures[1:], duration=round(1000 * apart / rate), loop=0)
    return out.getvalue()
