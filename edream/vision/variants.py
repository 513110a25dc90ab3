"""The models that are trained side by side: the dream model, its baseline and its ablation, all of one size."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from edream.core.errors import EdreamError
from edream.learn.training import Schedule
from edream.vision.clips import SOURCES, Jitter
from edream.vision.dreamer import DreamModel, Part

DREAM, REGRESSION, WITHOUT = "dream", "regression", "no objects"


@dataclass(frozen=True)
class DreamOptions:
    """The model and how it is trained; see `conf/dream/tiny.yaml` for each."""

    codec: Part
    denoiser: Part
    objective: Part
    train: Schedule = field(default_factory=Schedule)
    codec_steps: int = 0
    frames: int = 16
    train_frames: int = 6
    batch: int = 4
    checkpoint: int = 100
    known: float = 0.3
    overlap: int = 4
    onward: bool = False
    objects: bool = True
    sources: Mapping[str, float] = field(default_factory=lambda: {"real": 0.34, "sim": 0.33, "crop": 0.33})
    jitter: Jitter = field(default_factory=Jitter)
    baseline: bool = True
    ablation: bool = True
    device: str = "auto"
    compile: bool = False

    def __post_init__(self) -> None:
        shortest = min(self.frames, self.train_frames)
        if shortest < 2 or self.batch < 1 or self.checkpoint < 1 or not 0 <= self.overlap < shortest:
            raise EdreamError(
                f"dream has frames {shortest}, batch {self.batch}, checkpoint {self.checkpoint}, overlap {self.overlap}; expected "
                "at least 2, 1, 1 and an overlap below the frames."
            )
        for name, weight in self.sources.items():
            if name not in SOURCES or weight < 0:
                raise EdreamError(f"dream.sources names {name!r} with {weight}; expected weights for {', '.join(SOURCES)}.")
        if self.onward and self.objects:
            raise EdreamError("dream.onward is for video alone, without robot and objects; give dream.objects=false with it.")
        if self.device not in ("auto", "cpu", "cuda"):
            raise EdreamError(f"dream.device is {self.device!r}; expected auto, cpu or cuda.")


@dataclass(frozen=True)
class Variant:
    """One of the models: its name, its objective, and where its objects come from in training."""

    name: str
    objective: Part
    sources: Mapping[str, float]


def variants(options: DreamOptions, there: tuple[str, ...]) -> list[Variant]:
    """What is trained.

    Args:
        there: object sources that the conditions have.
    """
    known = {name: weight for name, weight in options.sources.items() if name in there and weight > 0} or {"real": 1.0}
    sources = known if options.objects else {"none": 1.0}
    found = [Variant(DREAM, options.objective, sources)]
    if options.baseline and options.objective.kind != REGRESSION:
        found.append(Variant(REGRESSION, Part(REGRESSION), sources))
    if options.ablation and options.objects:
        found.append(Variant(WITHOUT, options.objective, {"none": 1.0}))
    return found


def new_model(options: DreamOptions, variant: Variant, seed: int) -> DreamModel:
    """The model of a variant before training; all variants begin with the same weights.

    Raises:
        EdreamError: an entry, option or weights file is wrong.
    """
    model = DreamModel.of(options.codec, options.denoiser, variant.objective, seed)
    model.onward = options.onward
    return model
