"""Films of trials: what the cameras saw and the robot did at every step, as arrays, as an episode, as a moving picture."""

import io
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from PIL import Image

from edream.core.episode import Episode, Video
from edream.core.policy import Observation
from edream.practice.trial import Trial

MOST = 60  # images of a moving picture
IMAGES = "images/"


def film_of(film: Sequence[Observation], trial: Trial) -> dict[str, np.ndarray]:
    """Arrays over the steps: joints and actions (T, A), and images/NAME (T, H, W, 3)."""
    cameras = {IMAGES + name: np.stack([seen.images[name] for seen in film]) for name in film[0].images}
    return {"joints": np.stack([seen.joints for seen in film]), "actions": trial.actions} | cameras


def episode_of(film: Mapping[str, np.ndarray], name: str, order: Sequence[str], rate: float, notes: Mapping[str, str]) -> Episode:
    """A filmed trial as an episode, which any reader of episodes opens."""
    times = np.arange(len(film["joints"])) / rate
    videos = {key.removeprefix(IMAGES): _video(times, film[key]) for key in sorted(film) if key.startswith(IMAGES)}
    return Episode(name, tuple(order), times, film["joints"], times.copy(), film["actions"], videos=videos, notes=notes)


def _video(times: np.ndarray, images: np.ndarray) -> Video:
    def frames() -> Iterator[np.ndarray]:
        yield from images

    return Video(times, images.shape[1], images.shape[2], frames)


def moving_picture(film: Mapping[str, np.ndarray], rate: float) -> bytes:
    """An animated PNG of all cameras side by side, at most `MOST` images, at its true speed; empty without cameras."""
    views = [film[key] for key in sorted(film) if key.startswith(IMAGES)]
    if not views:
        return b""
    apart = max(1, -(-len(views[0]) // MOST))
    pictures = [Image.fromarray(row) for row in np.concatenate(views, axis=2)[::apart]]
    out = io.BytesIO()
    pictures[0].save(out, "PNG", save_all=True, append_images=pictures[1:], duration=round(1000 * apart / rate), loop=0)
    return out.getvalue()
