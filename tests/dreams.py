"""Small made-up episodes for tests of the dream model."""

from pathlib import Path

import numpy as np

from edream.vision.clips import Scenes


def small_scenes(folder: Path, size: int = 32, frames: int = 12, episodes: int = 3) -> Scenes:
    """A grey robot and a bright object that move over a fixed background; real images are warmer, noisy; the last is held out."""
    rng = np.random.default_rng(0)
    plate = rng.integers(90, 130, (size, size, 3)).astype(np.uint8)
    made = []
    for number in range(episodes):
        masks = np.zeros((frames, size, size, 3), np.uint8)
        for t in range(frames):
            x, y = 2 + (t + 3 * number) % (size // 2), size // 2 + t % 6
            masks[t, 4:12, x : x + 6, 0] = 255
            masks[t, y : y + 5, x + 4 : x + 9, 1] = 255
        masks[..., 2] = masks[..., 0]
        robot, sim = np.full_like(masks, 70), np.full_like(masks, 180)
        real = np.repeat(plate[None], frames, axis=0).astype(float)
        real[masks[..., 0] > 0] = (120, 100, 60)
        real[masks[..., 1] > 0] = (220, 60, 40)
        real = np.clip(real + rng.normal(0, 2, real.shape), 0, 255).astype(np.uint8)
        shares = np.stack([masks[..., 1], masks[..., 1], 0 * masks[..., 1]], axis=-1)
        layers = {"real": real, "robot": robot, "masks": masks, "object_sim": sim, "object_crop": sim, "object_masks": shares}
        made.append((f"episode_{number}", layers | {"reference": plate[None]}))
    folder.mkdir(exist_ok=True)
    return Scenes.gather(made, folder, {f"episode_{episodes - 1}"})
