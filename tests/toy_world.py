"""A world so small that a policy learns it in seconds: a point is to go to where a bright spot is."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from edream.core.policy import Observation, Outcome, StartNoise, World
from edream.learn.policy import PolicyShape, Scale
from edream.practice.about import PolicyAbout
from edream.practice.demonstrations import Demonstration
from edream.practice.trial import state_of

SIZE, STEPS = 24, 16
SMALL = {"dim": 32, "heads": 2, "feedforward": 64, "encoder": 1, "latent": 4, "widths": [8, 16, 16], "keypoints": 4}


class ToyWorld(World):
    """Two slides that follow their commands with a lag."""

    rate, seconds, actions, cameras = 8.0, STEPS / 8.0, 2, ("cam",)
    low, high = np.full(2, -1.0), np.full(2, 1.0)

    def __init__(self, bias: float = 0.0) -> None:
        self.bias = bias
        self.place, self.spot = np.zeros(2), np.zeros(2)

    def reset(self, start: int, noise: StartNoise | None = None) -> Observation:
        self.spot = np.random.default_rng((start, 7)).uniform(-0.7, 0.7, 2)
        self.place = np.zeros(2)
        if noise is not None:
            self.place = noise.joints * np.random.default_rng(noise.seed).standard_normal(2)
        return self._seen()

    def step(self, action: np.ndarray) -> Observation:
        self.place = self.place + 0.5 * (np.clip(action, self.low, self.high) + self.bias - self.place)
        return self._seen()

    def outcome(self) -> Outcome:
        distance = float(np.linalg.norm(self.place - self.spot))
        return Outcome(distance < 0.1, None, distance)

    def state(self) -> Mapping[str, np.ndarray]:
        return {"spot": np.array([*self.spot, 0.0, 1.0, 0.0, 0.0, 0.0])}

    def _seen(self) -> Observation:
        image = np.full((SIZE, SIZE, 3), 60, np.uint8)
        for point, colour in ((self.spot, (240, 200, 40)), (self.place, (40, 80, 240))):
            row, column = np.round((point + 1.0) * (SIZE - 1) / 2).astype(int).clip(1, SIZE - 2)
            image[row - 1 : row + 2, column - 1 : column + 2] = colour
        return Observation(self.place.copy(), {"cam": image})


def demonstrated(start: int, state: bool = False) -> Demonstration:
    """What an expert does: it commands the spot."""
    world = ToyWorld()
    seen = world.reset(start)
    joints, images, actions = [], [], []
    for step in range(STEPS):
        joints.append(seen.joints)
        images.append(seen.images["cam"][None])
        actions.append(world.spot * min(1.0, (step + 1) / 6))
        seen = world.step(actions[-1])
    rows = np.repeat(state_of(world.state())[None], STEPS, axis=0) if state else np.zeros((STEPS, 0))
    shown = np.stack(images) if not state else np.zeros((STEPS, 0, SIZE, SIZE, 3), np.uint8)
    return Demonstration(f"demo_{start}", np.stack(joints), np.stack(actions), shown, rows)


def about(demos: list[Demonstration], **more) -> PolicyAbout:
    """A small policy for this world."""
    cameras = demos[0].images.shape[1]
    joints, actions, state = (np.concatenate([getattr(one, name) for one in demos]) for name in ("joints", "actions", "state"))
    settings = {"options": SMALL, "chunk": 6, "stride": 3, "ensemble": None} | more
    shape = PolicyShape(2, settings.pop("chunk"), cameras, SIZE, SIZE, state.shape[1])
    scales = {"joints": Scale.of(joints), "actions": Scale.of(actions), "state": Scale.of(state)}
    return PolicyAbout(kind="act", shape=shape, order=("x", "y"), cameras=("cam",) * cameras, rate=8.0, **scales, **settings)


def open_toy(bias: float = 0.0) -> ToyWorld:
    """For other processes."""
    return ToyWorld(bias)


def kept(folder: Path, about_: PolicyAbout, network) -> Path:
    """Weights as other processes read them."""
    from edream import kinds
    from edream.learn.checkpoint import arrays

    path = folder / "policy.safetensors"
    kinds.write(arrays(network), path)
    return path
