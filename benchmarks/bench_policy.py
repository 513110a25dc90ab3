"""How fast a policy learns and acts: training steps a second through the real training loop, milliseconds a chunk of actions.

Speed does not depend on what is seen, so noise is: python -m benchmarks.bench_policy [--conf full] [--cameras 3]
[NAME=VALUE ...], such as sft.compile=true
"""

import argparse
import json
import os
import time

import torch

from edream import catalog, config
from edream.learn.determinism import deterministic
from edream.learn.device import device_of
from edream.learn.policy import Policy, PolicyShape, Seen
from edream.learn.training import new_state, train
from edream.stages.sft import Lesson, SftConfig


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--conf", default="tiny")
    asked.add_argument("--cameras", type=int, default=3)
    asked.add_argument("--actions", type=int, default=14)
    asked.add_argument("--steps", type=int, default=60)
    asked.add_argument("overrides", nargs="*")
    given = asked.parse_args()
    wanted = config.read(config.compose(["robot=arm6", "data=.", f"policy={given.conf}", *given.overrides]), SftConfig)
    options, sft = wanted.policy, wanted.sft
    device = device_of(options.device, "policy.device")
    gpu = device.type == "cuda"
    shape = PolicyShape(given.actions, options.chunk, given.cameras, options.height, options.width)
    network = catalog.load("policies", options.kind, Policy).build(shape, options.options).to(device)
    lesson = Lesson(network)
    if sft.compile:
        lesson.compile()
    batch, size = sft.batch, (options.height, options.width, 3)
    images = torch.randint(0, 255, (batch, given.cameras, *size), dtype=torch.uint8)
    seen = Seen(torch.randn(batch, given.actions), images, torch.zeros(batch, 0))
    actions = torch.randn(batch, options.chunk, given.actions)
    valid = torch.ones(batch, options.chunk, dtype=torch.bool)

    def loss_of(step: int) -> torch.Tensor:
        return lesson(seen.to(device), actions.to(device), valid.to(device), torch.Generator().manual_seed(step))

    def timed(steps: int) -> float:
        nonlocal state, done
        begun = time.perf_counter()
        state, _ = train(network, loss_of, state, done, done + steps, sft.train)
        done += steps
        return (time.perf_counter() - begun) / steps

    with deterministic():
        state, done = new_state(network), 0
        first = timed(5)
        seconds = timed(given.steps)
        network.eval()
        one = Seen(seen.joints[:1], images[:1], seen.state[:1]).to(device)
        acting = []
        with torch.no_grad():
            for _ in range(20):
                begun = time.perf_counter()
                network.chunk(one).cpu()
                acting.append(time.perf_counter() - begun)
    found = {
        "device": torch.cuda.get_device_name() if gpu else f"{torch.get_num_threads()} threads of {os.cpu_count()} cores",
        "parameters": sum(one.numel() for one in network.parameters()),
        "batch": batch,
        "precision": sft.train.precision,
        "compiled": sft.compile,
        "first_steps_s": 5 * first,
        "steps_per_s": 1.0 / seconds,
        "chunk_ms": 1e3 * sorted(acting)[len(acting) // 2],
        "memory_gib": torch.cuda.max_memory_allocated() / 2**30 if gpu else None,
    }
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
