"""How good dreamed video is: metrics by region, the robot's silhouette, seams and drift of long video."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool

from edream import catalog
from edream.core.errors import EdreamError, unknown_name
from edream.core.metric import Clips, Metric, Regions
from edream.vision.clips import Clip, Scenes, clip_of
from edream.vision.dreamer import DreamModel, finished
from edream.vision.grain import Grain
from edream.vision.plate import brightness, grown

PARTS = ("object", "robot", "not object")  # into which every metric is split


def real_clips(scenes: Scenes, picked: Sequence[tuple[int, int]], frames: int) -> Clips:
    """What the camera saw."""
    return np.stack([scenes.layers[n]["real"][f : f + frames] for n, f in picked])


def regions(scenes: Scenes, picked: Sequence[tuple[int, int]], frames: int) -> Regions:
    """Parts of the images: all, object (as segmented in the recording), not object, robot, and background (neither)."""
    masks = np.stack([scenes.layers[n]["masks"][f : f + frames] for n, f in picked])
    thing, robot = masks[..., 1] > 127, masks[..., 0] > 127
    return {
        "all": np.ones_like(thing),
        "object": thing,
        "not object": ~thing,
        "robot": robot & ~thing,
        "background": ~robot & ~thing,
    }


def drawn(
    model: DreamModel,
    scenes: Scenes,
    picked: Sequence[tuple[int, int]],
    frames: int,
    source: str,
    seed: int,
    grain: Grain | None,
    steps: int | None = None,
    given: int = 0,
) -> Clips:
    """Clips that the model makes of the conditions, and of the first `given` recorded images, which stay as they are."""
    device = next(model.denoiser.parameters()).device
    found = []
    for number, first in picked:
        clip = clip_of(scenes, [(number, first, source)], frames).to(device)
        h, w = clip.real.shape[-2:]
        noise = model.noise(1, frames, h, w, seed, first).to(device)
        made = finished(model.sample(clip, noise, steps, clip.real[:, :given] if given else None)[0], grain, seed, first)
        made[:given] = scenes.layers[number]["real"][first : first + given]  # which had their noise already
        found.append(made)
    return np.stack(found)


def composites(scenes: Scenes, picked: Sequence[tuple[int, int]], frames: int, source: str) -> Clips:
    """The conditions themselves: robot and object pasted over the background."""
    return np.stack([finished(clip_of(scenes, [(n, f, source)], frames).composite[0], None, 0) for n, f in picked])


def held_still(scenes: Scenes, picked: Sequence[tuple[int, int]], frames: int, given: int) -> Clips:
    """The first `given` recorded images, then the last of them for ever."""
    real = real_clips(scenes, picked, frames)
    return real[:, np.minimum(np.arange(frames), given - 1)]


def given_back(model: DreamModel, scenes: Scenes, picked: Sequence[tuple[int, int]], frames: int) -> Clips:
    """The recorded images through the codec and back: no model behind it can do better."""
    device = next(model.denoiser.parameters()).device
    found = []
    with torch.no_grad():
        for number, first in picked:
            real = clip_of(scenes, [(number, first, "none")], frames).to(device).real
            found.append(finished(model.decode(model.encode(real))[0], None, 0))
    return np.stack(found)


def plates(scenes: Scenes, picked: Sequence[tuple[int, int]], frames: int) -> Clips:
    """The background image alone."""
    return np.stack([np.repeat(np.asarray(scenes.references[n])[None], frames, axis=0) for n, _ in picked])


def ready_metrics(names: Sequence[str], weights: Mapping[str, Path]) -> dict[str, Metric]:
    """The metrics that can be computed: all that were named, or all there are but learned ones without weights.

    Raises:
        EdreamError: a metric does not exist, its weights are missing or do not fit, or weights are given that none takes.
    """
    there = {name: catalog.load("metrics", name, Metric) for name in names or catalog.names("metrics")}
    for name in weights:
        if name not in there or not there[name].learned:
            raise unknown_name("metric that takes score.weights:", name, [n for n, one in there.items() if one.learned])
    lacking = [name for name, one in there.items() if one.learned and name not in weights]
    if names and lacking:
        raise EdreamError(
            f"Metric {lacking[0]!r} needs score.weights.{lacking[0]}=PATH; docs/dream.md says which weights those are."
        )
    return {name: one.ready(weights[name]) if one.learned else one for name, one in there.items() if name not in lacking}


def scores(made: Clips, real: Clips, where: Regions, metrics: Mapping[str, Metric]) -> dict[str, dict[str, float | None]]:
    """Every metric over every region, metric -> region -> number.

    Metrics of whole images are taken over a part by putting that part into the real images: what that part alone costs. Learned
    ones of them, which are slow, have "all" alone. Flicker's background is without what lies near moving edges.
    """
    parts = {part: where[part] for part in PARTS}
    still = {"background": _still(where["background"]), **parts}  # moving edges would drown flicker
    found: dict[str, dict[str, float | None]] = {}
    for name, metric in metrics.items():
        if metric.regional:
            found[name] = metric.each(made, real, still if name == "flicker" else where)
        else:
            found[name] = {"all": metric.score(made, real, where["all"])}
            for part, region in () if metric.learned else parts.items():
                found[name][part] = metric.score(_put(made, real, region), real, where["all"]) if region.any() else None
    return found


def _put(made: Clips, real: Clips, region: Bool[np.ndarray, "N T H W"]) -> Clips:
    return np.where(region[..., None], made, real)


def _still(background: Bool[np.ndarray, "N T H W"]) -> Bool[np.ndarray, "N T H W"]:
    return np.stack([[~grown(~frame, 3) for frame in clip] for clip in background])


def silhouette_iou(made: Clips, scenes: Scenes, picked: Sequence[tuple[int, int]], where: Regions) -> float | None:
    """Overlap of the robot that is to be seen with the simulated one: what differs from the background near the robot, not
    counting the object. Shadows and parts of the background's colour keep it below 1 even for real video, whose own value
    is the measure. None where no robot is simulated."""
    common = total = 0
    for clip, (number, first), thing in zip(made, picked, where["object"], strict=True):
        plate = np.asarray(scenes.references[number]).astype(np.float32)
        robot = scenes.layers[number]["masks"][first : first + len(clip), ..., 0] > 127
        gain = brightness(clip, plate)
        for image, mask, other, scale in zip(clip, robot, thing, gain, strict=True):
            near = grown(mask, 3) & ~grown(other, 2)
            apart = np.abs(image * scale - plate).max(axis=2) > 28.0
            common += int((apart & mask & near).sum())
            total += int(((apart | mask) & near).sum())
    return common / total if total else None


def to_and_fro(length: int, frames: int) -> np.ndarray:
    """Rows that play an episode forwards and backwards until there are enough."""
    there_and_back = np.r_[np.arange(length), np.arange(length - 2, 0, -1)]
    return np.resize(there_and_back, frames)


def long_video(
    model: DreamModel, scenes: Scenes, number: int, frames: int, chunk: int, overlap: int, source: str, seed: int
) -> dict[str, Any]:
    """A long video, chunk by chunk: how much it jumps where chunks meet, and how much worse its end is than its beginning.

    Returns:
        `seam_ratio`: second difference in time at seams over that elsewhere (1: no seams), `drift_db`: PSNR of the first quarter
        minus that of the last, less what the composite itself changes.
    """
    size = scenes.lengths()[number]
    rows = to_and_fro(size, frames)
    whole = clip_of(scenes, [(number, 0, source)], size)
    names = ("real", "composite", "background", "robot", "object")
    device = next(model.denoiser.parameters()).device
    clip = Clip(*(getattr(whole, name)[:, rows] for name in names)).to(device)
    made = model.long(clip, seed, chunk, overlap)[0].cpu()
    real, pasted = clip.real[0].cpu(), clip.composite[0].cpu()
    bend = (made[:-2] - 2.0 * made[1:-1] + made[2:]).square().mean(dim=(1, 2, 3))
    calm = (real[:-2] - 2.0 * real[1:-1] + real[2:]).square().mean(dim=(1, 2, 3))
    seams = {i for start in range(chunk, frames, chunk - overlap) for i in (start - 2, start - 1) if 0 <= i < len(bend)}
    at = torch.tensor([i in seams for i in range(len(bend))])
    relative = bend / calm.clamp(min=1e-8)
    quarter = frames // 4
    drift = [_psnr(v[:quarter], real[:quarter]) - _psnr(v[-quarter:], real[-quarter:]) for v in (made, pasted)]
    return {
        "frames": frames,
        "chunk": chunk,
        "overlap": overlap,
        "seam_ratio": float((relative[at].mean() / relative[~at].mean()).sqrt()),
        "drift_db": drift[0] - drift[1],
    }


def _psnr(a: torch.Tensor, b: torch.Tensor) -> float:
    return float(10.0 * torch.log10(4.0 / (a - b).square().mean().clamp(min=1e-12)))
