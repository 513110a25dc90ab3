"""Score: what the dream model and all that it is compared with are worth on episodes that none of them saw."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from edream import catalog
from edream.core.metric import Clips
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.layered import layered_images
from edream.ingest.video import encode_image
from edream.learn.determinism import deterministic
from edream.learn.device import device_of
from edream.vision.clips import STORED, Scenes, starts
from edream.vision.dreamer import DreamModel
from edream.vision.grain import Grain
from edream.vision.judging import (
    composites,
    drawn,
    given_back,
    held_still,
    long_video,
    plates,
    ready_metrics,
    real_clips,
    regions,
    scores,
    silhouette_iou,
)
from edream.vision.strips import film_strip, side_by_side
from edream.vision.trained import loaded
from edream.vision.variants import DREAM, REGRESSION, WITHOUT, DreamOptions, variants

Row = tuple[str, Callable[[], Clips]]
CODEC_ALONE = "codec alone"
AFTER = " after "  # in the label of a row that is given the first images, and judged on the others


@dataclass(frozen=True)
class ScoreOptions:
    """What is measured; see `conf/score/default.yaml` for each."""

    clips: int = 32
    steps: tuple[int, ...] = (4,)
    metrics: tuple[str, ...] = ()
    weights: Mapping[str, Path | None] = field(default_factory=dict)
    grain: bool = True
    strips: int = 4
    long: int = 200


@dataclass(frozen=True)
class ScoreRender:
    """Of the rendering its rate counts here, for the speed of the pictures, and whether there is a robot."""

    rate: float | None = None
    model: str = "fit"


@dataclass(frozen=True)
class ScoreConfig:
    """What score reads."""

    dream: DreamOptions
    score: ScoreOptions
    render: ScoreRender
    seed: int


@dataclass(frozen=True, eq=False)
class Bench:
    """What every row is made from."""

    models: Mapping[str, DreamModel]
    scenes: Scenes
    picked: Sequence[tuple[int, int]]
    frames: int
    seed: int
    sources: tuple[str, ...]
    grains: Mapping[str, Grain]
    steps: tuple[int, ...] = field(default=())
    given: int = 0

    def drawn(self, name: str, source: str, grainy: bool, steps: int | None = None, given: int = 0) -> Clips:
        """Clips of one model, with the camera's noise put back or not."""
        grain = self.grains.get(name) if grainy else None
        return drawn(self.models[name], self.scenes, self.picked, self.frames, source, self.seed, grain, steps, given)


def run(inputs: Mapping[str, Artifact], config: ScoreConfig, work: Work) -> Bundle:
    """Draw held-out clips from every model and measure them, beside plate and pasted composite."""
    options, asked, about = config.dream, config.score, inputs["condition"]["summary.json"]
    scenes = Scenes.gather(layered_images(inputs["condition"], STORED), work.folder("images"), about["held"])
    picked = _picked(scenes, options.frames, asked.clips)
    real, where = real_clips(scenes, picked, options.frames), regions(scenes, picked, options.frames)
    models = {v.name: loaded(inputs["dream"], options, v, config.seed) for v in variants(options, tuple(about["object_sources"]))}
    sources = tuple(about["object_sources"]) if options.objects else ("none",)
    grains = {name: Grain(tuple(levels)) for name, levels in inputs["dream"]["grain.json"].items()} if asked.grain else {}
    bench = Bench(
        models, scenes, picked, options.frames, config.seed, sources, grains, asked.steps, options.overlap if options.known else 0
    )
    named = tuple(dict.fromkeys(("psnr", *asked.metrics))) if asked.metrics else ()  # the sentence needs it
    metrics = ready_metrics(named, _weights(asked))
    rows = dict(_rows(bench, config.render.model == "none"))

    def measured(label: str, rng: np.random.Generator) -> Bundle:
        with deterministic():
            made = rows[label]()
        first = bench.given if AFTER in label else 0
        parts = {name: mask[:, first:] for name, mask in where.items()}
        found = scores(made[:, first:], real[:, first:], parts, metrics)
        found |= {"silhouette_iou": {"robot": silhouette_iou(made, scenes, picked, where)}}
        return {"found.json": found, "made.safetensors": {"made": made}}

    spread = device_of(options.device, "dream.device").type == "cpu"  # a network on a GPU cannot be sent to machines without one
    kept = work.shards("rows", list(rows), measured, parallel="elsewhere" if spread else False)
    clips = {label: one["made.safetensors"]["made"] for label, one in zip(rows, kept, strict=True)}
    table: list[dict[str, Any]] = [{"label": label, **one["found.json"]} for label, one in zip(rows, kept, strict=True)]
    with deterministic():
        longest = _long(models[DREAM], scenes, options, sources[0], config.seed, asked.long)
    table.append({"label": "real", "silhouette_iou": {"robot": silhouette_iou(real, scenes, picked, where)}})
    main, bases = _main_rows(bench, config.render.model == "none")
    pictures, about_pictures = _pictures(
        clips | {"real": real}, main, bases, sources, asked.strips, config.render.rate or 12.5, bench.given
    )
    summary = _summary(table, main, bases, sources, inputs["dream"]["summary.json"], longest, len(picked), options)
    told = {"metrics": {name: one.about for name, one in metrics.items() if one.learned}}
    told |= {"not_computed": [name for name in catalog.names("metrics") if name not in metrics]}
    return pictures | {
        "summary.json": summary | {"not_computed": told["not_computed"]},
        "scores.json": {"rows": table, "long": longest, "pictures": about_pictures, **told},
    }


def _picked(scenes: Scenes, frames: int, most: int) -> list[tuple[int, int]]:
    """Held-out clips: end to end, or half overlapping where that gives too few."""
    found = starts(scenes, frames, True, frames)
    if len(found) < most:
        found = starts(scenes, frames, True, max(1, frames // 2))
    return [found[i] for i in np.unique(np.linspace(0, len(found) - 1, min(most, len(found))).astype(int))]


def _rows(bench: Bench, alone: bool) -> Iterator[Row]:
    """Everything that is measured, each with a function that makes its clips; of video alone, what is compared with holding the
    first images still goes on from the same images."""
    first, model = bench.sources[0], bench.models[DREAM]
    after = f"{AFTER}{bench.given} real images" if bench.given else ""
    ours, given = (after, bench.given) if alone else ("", 0)
    yield "plate", lambda: plates(bench.scenes, bench.picked, bench.frames)
    for source in dict.fromkeys([*bench.sources, "none"]):
        yield f"composite {source}", lambda source=source: composites(bench.scenes, bench.picked, bench.frames, source)
    if not model.codec.lossless:
        yield f"{CODEC_ALONE}{ours}", lambda: given_back(model, bench.scenes, bench.picked, bench.frames)
    for source in bench.sources:
        yield f"{DREAM} {source}", lambda source=source: bench.drawn(DREAM, source, True)
    if bench.given:
        yield f"held still{after}", lambda: held_still(bench.scenes, bench.picked, bench.frames, bench.given)
        yield f"{DREAM} {first}{after}", lambda: bench.drawn(DREAM, first, True, None, bench.given)
    if bench.grains:
        yield f"{DREAM} {first} without grain{ours}", lambda: bench.drawn(DREAM, first, False, None, given)
    for steps in bench.steps:
        if steps != model.objective.steps:
            words = f"in {steps} step{'s' if steps > 1 else ''}"
            yield f"{DREAM} {first} {words}{ours}", lambda steps=steps: bench.drawn(DREAM, first, True, steps, given)
    if REGRESSION in bench.models:
        for source in bench.sources:
            yield f"{REGRESSION} {source}", lambda source=source: bench.drawn(REGRESSION, source, False)
        if bench.given and alone:
            yield f"{REGRESSION} {first}{after}", lambda: bench.drawn(REGRESSION, first, False, None, bench.given)
        if bench.grains:
            yield f"{REGRESSION} {first} with grain", lambda: bench.drawn(REGRESSION, first, True)
    if WITHOUT in bench.models:
        yield WITHOUT, lambda: bench.drawn(WITHOUT, "none", True)


def _long(model: DreamModel, scenes: Scenes, options: DreamOptions, source: str, seed: int, frames: int) -> dict[str, Any]:
    if frames < 2 * options.frames:
        return {}
    number = max((n for n in range(len(scenes.names)) if scenes.held[n]), key=lambda n: scenes.lengths()[n])
    return long_video(model, scenes, number, frames, options.frames, options.overlap, source, seed)


def _main_rows(bench: Bench, alone: bool) -> tuple[str, list[str]]:
    """The row that counts and what it must beat; of video alone, where nothing says what moves, both have the first images."""
    if alone and bench.given:
        after = f"{AFTER}{bench.given} real images"
        return f"{DREAM} {bench.sources[0]}{after}", [f"held still{after}"]
    composites = [f"composite {source}" for source in dict.fromkeys([*bench.sources, "none"])]
    return f"{DREAM} {bench.sources[0]}", [*composites, "plate"]


def _pictures(
    clips: Mapping[str, Clips], main: str, bases: Sequence[str], sources: Sequence[str], count: int, rate: float, given: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Film strips of the worst clips; moving pictures of the worst, the median and the best one, side by side."""
    real, first = clips["real"], given if AFTER in main else 0  # images that were given are right without any merit
    error = np.square(clips[main][:, first:].astype(np.float32) - real[:, first:].astype(np.float32)).mean(axis=(1, 2, 3, 4))
    order = np.argsort(-error, kind="stable")
    rows = [
        f"composite {sources[0]}",
        *(f"{DREAM} {s}" for s in sources),
        *(r for r in clips if AFTER in r),
        REGRESSION + f" {sources[0]}",
        WITHOUT,
        "real",
    ]
    rows = [label for label in rows if label in clips and (not first or AFTER in label or label == "real")]
    found: dict[str, Any] = {}
    for rank, index in enumerate(order[:count]):
        found[f"strip-{rank}.png"] = encode_image(film_strip([clips[label][index] for label in rows], scale=1), "png")
    middle = int(order[len(order) // 2])
    copied_nothing = [f"{DREAM} {source}" for source in sources[1:]]
    moving = [bases[0], main, *copied_nothing[-1:], "real"]
    shown = {"moving.png": middle, "moving-worst.png": int(order[0]), "moving-best.png": int(order[-1])}
    found |= {name: side_by_side([clips[label][one] for label in moving], rate) for name, one in shown.items()}
    psnr = 10.0 * np.log10(255.0**2 / np.maximum(error, 1e-9))
    return found, {
        "rows": rows,
        "moving": moving,
        "psnr": [float(psnr[i]) for i in order[:count]],
        "median_psnr": float(psnr[middle]),
        "moving_psnr": {name: float(psnr[one]) for name, one in shown.items()},
    }


def _summary(
    table: Sequence[Mapping[str, Any]],
    main_row: str,
    bases: Sequence[str],
    sources: Sequence[str],
    trained: Mapping[str, Any],
    longest: Mapping[str, Any],
    clips: int,
    options: DreamOptions,
) -> dict[str, Any]:
    rows = {row["label"]: row for row in table}
    main = rows[main_row]
    best = max(bases, key=lambda label: rows[label]["psnr"]["not object"])
    reached = main["psnr"]["not object"]
    gain = reached - rows[best]["psnr"]["not object"]
    outside = " outside the object" if options.objects else ""
    summary: dict[str, Any] = {
        "sentence": f"Dreamed video reaches {reached:.1f} dB{outside} on {clips} clips it never saw, {gain:+.1f} dB on {best!r}.",
        **{name: next(iter(row.values())) for name, row in main.items() if name != "label"},
        "gain_outside_object_db": gain,
        "main_row": main_row,
        "clips": clips,
        "frames": options.frames,
        "codec_psnr": trained["codec_psnr"],
        "weights_digest": trained["weights_digest"],
    }
    for words in ("", " with grain"):
        row = rows.get(f"{REGRESSION} {sources[0]}{words}", {"label": ""})
        prefix = f"{REGRESSION}{words}".replace(" ", "_")
        summary |= {f"{prefix}_{name}": next(iter(value.values())) for name, value in row.items() if name != "label"}
    if WITHOUT in rows:
        for source in sources:
            both = [rows[label]["psnr"]["object"] for label in (f"{DREAM} {source}", WITHOUT)]
            if None not in both:
                summary[f"object_gain_{source}_db"] = both[0] - both[1]
    return summary | {f"long_{name}": value for name, value in longest.items()}


def _weights(asked: ScoreOptions) -> dict[str, Path]:
    return {name: path for name, path in asked.weights.items() if path is not None}


def sources(config: ScoreConfig) -> Mapping[str, Source]:
    """Weights of learned metrics; those of the model are part of the stage before."""
    return {f"metric {name}": path for name, path in _weights(config.score).items()}


ENTRY = Stage("score", 5, ("condition", "dream"), ScoreConfig, run, sources, ("torch", "numpy", "scikit-image"))
