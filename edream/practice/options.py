"""What the config says about policies and how they are trained; see `conf/policy/tiny.yaml` and its neighbours for each."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from edream.core.errors import require
from edream.learn.training import Schedule
from edream.practice.changing import Change
from edream.practice.shaking import Shake


@dataclass(frozen=True)
class PolicyOptions:
    """The policy: its network, what it sees, and how its chunks are executed.

    Attributes:
        kind: entry of `edream/policies/`.
        options: the entry's own.
        chunk: actions predicted at once.
        stride: actions executed before the next chunk is asked for.
        ensemble: m of temporal ensembling, or None.
        cameras: views, or None for all that the demonstrations have; [] for none.
        height, width: size of each view [pixel].
        rate: control steps a second [Hz], or None for the demonstrations' own.
        objects: scene file with the tracks of objects, whose poses the policy sees as numbers (state mode), or None.
        device: auto, cpu or cuda.
    """

    kind: str = "act"
    options: Mapping[str, Any] = field(default_factory=dict)
    chunk: int = 16
    stride: int = 8
    ensemble: float | None = None
    cameras: tuple[str, ...] | None = None
    height: int = 64
    width: int = 64
    rate: float | None = None
    objects: Path | None = None
    device: str = "auto"

    def __post_init__(self) -> None:
        require(1 <= self.stride <= self.chunk, "policy.stride", self.stride, f"1 to policy.chunk ({self.chunk})")
        require(self.ensemble is None or self.ensemble >= 0.0, "policy.ensemble", self.ensemble, "0 or more, or null")
        require(min(self.height, self.width) >= 16, "policy.height or policy.width", min(self.height, self.width), "at least 16")
        require(self.rate is None or self.rate > 0.0, "policy.rate", self.rate, "Hz above 0, or null")
        require(self.device in ("auto", "cpu", "cuda"), "policy.device", self.device, "auto, cpu or cuda")


@dataclass(frozen=True)
class Acting:
    """Of the policy only where it is run.

    Attributes:
        device: auto, cpu or cuda.
    """

    device: str = "auto"


@dataclass(frozen=True)
class SftOptions:
    """Training on demonstrations.

    Attributes:
        train: how long and how fast.
        batch: samples a step.
        checkpoint: steps after which the state is kept and the held-out demonstrations are judged.
        held: share of the demonstrations that is held out, at least one.
        apart: held-out steps that are judged lie this far apart.
        shake: how training images are shaken.
        twins: whether every demonstration is also learned as the simulator's eyes see it, before the photo `rollouts.plate`, its
            robot as measured and its things as tracked (`render.scene`); so that trials there are no strange sight.
        start: folder of a policy to go on from (a bundle, or an artifact of sft or rl), or None to begin with weights from chance.
        change: how the scenes of training images are changed, recorded ones and twins alike.
        hidden: share of the training samples whose measured joints are hidden (at their mean), so that the policy looks: where the
            arm is already tells most of where a demonstration is going, and of that a policy must not learn to be content.
        compile: whether torch's compiler makes the steps; a minute at first, faster steps after it on a GPU.
    """

    train: Schedule = field(default_factory=Schedule)
    batch: int = 32
    checkpoint: int = 250
    held: float = 0.1
    apart: int = 5
    shake: Shake = field(default_factory=Shake)
    twins: bool = False
    start: Path | None = None
    change: Change = field(default_factory=Change)
    hidden: float = 0.0
    compile: bool = False

    def __post_init__(self) -> None:
        for name in ("batch", "checkpoint", "apart"):
            require(getattr(self, name) >= 1, f"sft.{name}", getattr(self, name), "at least 1")
        require(self.twins or not self.change.share, "sft.twins", self.twins, "true where scenes are changed (sft.change.share)")
        require(0.0 <= self.hidden < 1.0, "sft.hidden", self.hidden, "a share, 0 or more and below 1")
        require(0.0 < self.held < 1.0, "sft.held", self.held, "a share between 0 and 1")
