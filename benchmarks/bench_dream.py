"""How fast dreaming is: seconds a clip of 16 frames, milliseconds a streamed frame, seconds a training step.

Speed does not depend on what was learned, so a new model is timed: python -m benchmarks.bench_dream [--conf full] [NAME=VALUE ...]
"""

import argparse
import json
import os
import time
from collections.abc import Callable

import numpy as np
import torch

from edream import config
from edream.learn.determinism import threads
from edream.learn.device import device_of
from edream.stages.dream import DreamConfig
from edream.vision.clips import Clip
from edream.vision.dreamer import Dreamer, Render
from edream.vision.variants import DREAM, Variant, new_model


def timed(work: Callable[[], object], repeats: int, cuda: bool) -> dict[str, float]:
    """Median wall clock and mean processor seconds of one call, after one that does not count."""
    work()
    walls, begun = [], time.process_time()
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        if cuda:
            torch.cuda.synchronize()
        walls.append(time.perf_counter() - start)
    return {"wall_s": float(np.median(walls)), "cpu_s": (time.process_time() - begun) / repeats}


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--conf", default="tiny")
    asked.add_argument("--height", type=int, default=64)
    asked.add_argument("--width", type=int, default=64)
    asked.add_argument("--repeats", type=int, default=10)
    asked.add_argument("--steps", type=int, nargs="+", default=[1, 2, 4])
    asked.add_argument("--no-train", action="store_true")
    asked.add_argument("overrides", nargs="*")
    given = asked.parse_args()
    torch.set_num_threads(threads())
    options = config.read(config.compose([f"dream={given.conf}", *given.overrides]), DreamConfig).dream
    device = device_of(options.device, "dream.device")
    model = new_model(options, Variant(DREAM, options.objective, {"real": 1.0}), 0).to(device)
    h, w, frames = given.height, given.width, options.frames

    def clip(count: int) -> Clip:
        return Clip(*(torch.rand(count, frames, k, h, w, device=device) for k in (3, 3, 3, 1, 1)))

    cuda = device.type == "cuda"
    narrow = torch.autocast(device.type, torch.bfloat16, enabled=options.train.precision == "bfloat16")
    found: dict[str, object] = {
        "device": torch.cuda.get_device_name() if cuda else f"{torch.get_num_threads()} threads of {os.cpu_count()} cores",
        "load": os.getloadavg()[0],
        "parameters": sum(p.numel() for p in model.denoiser.parameters()),
        "size": [frames, h, w],
    }
    one, noise = clip(1), model.noise(1, frames, h, w, 0).to(device)
    with narrow:
        found["clip"] = {steps: timed(lambda s=steps: model.sample(one, noise, s), given.repeats, cuda) for steps in given.steps}
        if not given.no_train:
            batch, known = clip(options.batch), torch.zeros(options.batch, frames, dtype=torch.bool, device=device)
            found["training_step"] = timed(lambda: model.loss(batch, known, torch.Generator().manual_seed(0)).backward(), 3, cuda)
    if model.denoiser.streams:
        dreamer = Dreamer(model, np.zeros((h, w, 3), np.uint8))
        state = dreamer.start()
        blank = Render(*(np.zeros(shape, np.uint8) for shape in ((h, w, 3), (h, w), (h, w, 3), (h, w))))

        def step() -> None:
            nonlocal state
            state, _ = dreamer.step(state, blank)

        found["stream_frame"] = timed(step, 40, cuda)
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
