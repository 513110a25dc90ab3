"""A policy as a folder that somebody takes to a robot: weights, form and scales, and a loop to start from."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from edream.core.errors import EdreamError
from edream.learn.checkpoint import read_weights
from edream.practice.about import ABOUT, WEIGHTS, PolicyAbout
from edream.practice.trial import Plans
from edream.vision.frames import resized

LOOP = '''"""Run the policy in this folder on a robot. Fill in the two functions that know your robot, then run it.

Joints and actions are positions [rad, or m for slides] in the order of policy.json ("order"); images are RGB, (H, W, 3) uint8.
A policy that was trained with policy.objects wants to know where they are, too: let read_robot return, as a third, what
edream.practice.trial.state_of makes of their poses.
"""

import time
from pathlib import Path

import numpy as np

from edream.practice.bundle import RunningPolicy


def read_robot() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Measured joint positions, (A,), and an image of each camera that policy.json names."""
    raise NotImplementedError("read your robot's joints and cameras here")


def command_robot(positions: np.ndarray) -> None:
    """Send position commands, (A,)."""
    raise NotImplementedError("send the commands to your robot here, within its limits")


policy = RunningPolicy(Path(__file__).parent)
policy.begin()
due = time.monotonic()
for _ in range(round(SECONDS * policy.about.rate)):  # as long as a trial
    command_robot(policy.act(*read_robot()))
    due += 1.0 / policy.about.rate
    time.sleep(max(0.0, due - time.monotonic()))
'''


def about_in(folder: Path) -> PolicyAbout:
    """What is known of the policy in a folder: a bundle, or what a stage made.

    Raises:
        EdreamError: there is none, or it is damaged.
    """
    path = folder / ABOUT
    try:
        return PolicyAbout.of(json.loads(path.read_text()))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise EdreamError(
            f"{path} is no policy: {type(error).__name__} {error}; expected what edream export-policy wrote."
        ) from error


def going_on(about: PolicyAbout, folder: Path) -> PolicyAbout:
    """A policy that begins with the weights of the one in a folder, and so keeps its scales.

    Raises:
        EdreamError: it is another kind of policy, sees something else or moves other joints.
    """
    earlier = about_in(folder)
    for name in ("kind", "options", "shape", "order", "cameras", "rate"):
        old, new = getattr(earlier, name), getattr(about, name)
        if old != new:
            raise EdreamError(f"sft.start={folder} holds a policy with {name} {old}; the settings and recordings ask for {new}.")
    return replace(about, joints=earlier.joints, actions=earlier.actions, state=earlier.state)


class RunningPolicy:
    """A policy from a bundle, one observation after the other.

    Args:
        folder: what `edream export-policy` wrote.

    Raises:
        EdreamError: a file is missing or damaged.
    """

    def __init__(self, folder: Path) -> None:
        self.about = about_in(folder)
        self._network = self.about.network(read_weights(folder / WEIGHTS)).eval()
        self.begin()

    def begin(self) -> None:
        """A new trial begins."""
        self._plans, self._step = Plans(self.about.ensemble), 0

    def act(self, joints: np.ndarray, images: Mapping[str, np.ndarray], state: np.ndarray | None = None) -> np.ndarray:
        """The commands for the next period, (A,).

        Args:
            joints: measured positions, (A,).
            images: camera name -> RGB image of any size.
            state: further numbers, where the policy was trained with them.

        Raises:
            EdreamError: a camera is missing, or there are other numbers than the policy was trained with.
        """
        about, more = self.about, np.zeros(0) if state is None else np.asarray(state)
        numbers = (("joint positions", np.asarray(joints), about.shape.actions), ("further numbers", more, about.shape.state))
        for what, given, size in numbers:
            if given.shape != (size,):
                raise EdreamError(f"The {what} have the shape {given.shape}; the policy was trained with {(size,)}.")
        if self._step % about.stride == 0:
            missing = [name for name in about.cameras if name not in images]
            if missing:
                raise EdreamError(
                    f"There is no image of camera {missing[0]!r}, which the policy needs; there are {', '.join(images)}."
                )
            size = (about.shape.height, about.shape.width)
            seen = [resized(images[name], *size) for name in about.cameras]
            views = np.stack(seen) if seen else np.zeros((0, *size, 3), np.uint8)
            with torch.no_grad():
                chunk = self._network.chunk(about.seen(np.asarray(joints)[None], views[None], more[None]))[0].numpy()
            self._plans.add(self._step, about.actions.back(chunk))
        self._step += 1
        return self._plans.action(self._step - 1)


def write_bundle(source: Mapping[str, Any], out: Path, seconds: float) -> dict[str, Any]:
    """Write a policy that a stage made as the new folder `out`.

    Args:
        seconds: how long its loop runs, as a trial of its task does.
    """
    from safetensors.numpy import save_file

    out.mkdir(parents=True)
    save_file({name: np.ascontiguousarray(value) for name, value in sorted(source[WEIGHTS].items())}, out / WEIGHTS)
    (out / ABOUT).write_text(json.dumps(source[ABOUT], indent=1, sort_keys=True) + "\n")
    (out / "run_policy.py").write_text(LOOP.replace("SECONDS", f"{seconds:g}"))
    about = source[ABOUT]
    return {
        "sentence": f"The policy lies in {out}: weights, scales and a loop to start from.",
        "bundle": str(out),
        "cameras": list(about["cameras"]),
        "rate_hz": about["rate"],
        "joints": list(about["order"]),
    }
