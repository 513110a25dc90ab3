"""The report of dreamed video: strips and a moving picture to look at, and every number beside what it must beat."""

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure as Canvas

from edream.report.page import AFTER, BEFORE, COMMAND, PUBLISHED, Figure, draw, log_scale, page
from edream.report.recordings import about_recordings

COLUMNS = (  # metric, region, heading
    ("psnr", "all", "PSNR [dB]"),
    ("psnr", "not object", "outside object"),
    ("psnr", "object", "object"),
    ("psnr", "robot", "robot"),
    ("psnr", "background", "background"),
    ("ssim", "all", "SSIM"),
    ("lpips", "all", "LPIPS"),
    ("fvd", "all", "FVD"),
    ("gabor_distance", "all", "Gabor distance"),
    ("gabor_frechet", "all", "Gabor Fréchet"),
    ("flicker", "background", "flicker (1 is right)"),
    ("silhouette_iou", "robot", "silhouette IoU"),
)
PARTS = {"object": "object", "robot": "robot", "not object": "outside"}  # region, heading
SPLIT = {
    "psnr": "PSNR [dB]",
    "ssim": "SSIM",
    "lpips": "LPIPS",
    "gabor_distance": "Gabor distance",
    "gabor_frechet": "Gabor Fréchet",
    "flicker": "flicker",
}
MOVING = {"moving-worst.png": "Worst clip", "moving.png": "Median clip", "moving-best.png": "Best clip"}
COLOURS = (AFTER, BEFORE, PUBLISHED, COMMAND)


def dream_page(made: Mapping[str, Mapping[str, Any]], robot: str) -> str:
    """The page as HTML.

    Args:
        made: stage -> file name -> value, of ingest, camera, render, masks, condition, dream and score.
        robot: what to call it.
    """
    scored = made["score"]
    summary, scores = scored["summary.json"], scored["scores.json"]
    pictures = scores["pictures"]
    columns = [(m, r, heading) for m, r, heading in COLUMNS if any(m in row for row in scores["rows"])]
    content = {
        "title": f"Dreamed video of {robot}",
        "sentence": summary["sentence"],
        "summary": summary,
        "tiles": _tiles(summary),
        "columns": [heading for _, _, heading in columns],
        "rows": [{"label": row["label"], "cells": [_cell(row, m, r) for m, r, _ in columns]} for row in scores["rows"]],
        "parts": _split(scores["rows"]),
        "learned": learned_words(scores),
        "long": scores["long"],
        "moving": [
            _labelled(name, f"{title}: {pictures['moving_psnr'][name]:.1f} dB", pictures["moving"], scored[name], "above")
            for name, title in MOVING.items()
        ],
        "strips": [
            _labelled(
                f"strip-{rank}",
                f"{'Worst clip' if rank == 0 else f'Number {rank + 1} from the bottom'}: {psnr:.1f} dB",
                pictures["rows"],
                scored[f"strip-{rank}.png"],
                "beside",
            )
            for rank, psnr in enumerate(pictures["psnr"])
        ],
        "overlay": _picture(
            "masks", "Where objects were found", made["masks"]["summary.json"]["sentence"], made["masks"]["overlay.png"]
        ),
        "plate": _picture(
            "plate", "The background plate", _plate_words(made["masks"]["summary.json"]), made["masks"]["plate.png"], False
        ),
        "losses": losses(made["dream"]["losses.json"]),
        "stages": [
            made[name]["summary.json"]["sentence"] for name in ("camera", "render", "masks", "condition", "dream") if name in made
        ],
        "recordings": about_recordings(made["ingest"]),
    }
    return page("dream.html.j2", content)


def _split(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What networks made, by part of the image, with and without object segmentation: every metric that has parts."""
    made = [row for row in rows if row["label"].split()[0] not in ("plate", "composite", "codec", "held", "real")]
    metrics = {name: title for name, title in SPLIT.items() if any(set(PARTS) <= set(row.get(name, {})) for row in made)}
    cells = [{"label": row["label"], "cells": [_cell(row, metric, part) for metric in metrics for part in PARTS]} for row in made]
    return {"metrics": list(metrics.values()), "names": list(PARTS.values()), "rows": cells if len(made) > 1 else []}


def learned_words(scores: Mapping[str, Any]) -> str:
    """Which learned metrics there are, and which are not computed for want of weights."""
    names = {"lpips": "LPIPS", "fvd": "FVD"}
    there = [f"{about}." for about in scores["metrics"].values()]
    lacking = [names[name] for name in scores["not_computed"] if name in names]
    said = [f"{' and '.join(lacking)}: not computed, for no weights were given (score.weights)."] if lacking else []
    return " ".join([*there, *said])


def _tiles(summary: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    found = [
        ("PSNR", f"{summary['psnr']:.1f}", "dB"),
        ("gain on what needs no training", f"{summary['gain_outside_object_db']:+.1f}", "dB"),
        ("flicker, 1 is right", None if summary.get("flicker") is None else f"{summary['flicker']:.2f}", ""),
        ("silhouette IoU", None if summary["silhouette_iou"] is None else f"{summary['silhouette_iou']:.2f}", ""),
        ("judged on", str(summary["clips"]), f"clips of {summary['frames']} images"),
    ]
    return [(label, value, unit) for label, value, unit in found if value is not None]


def _cell(row: Mapping[str, Any], metric: str, region: str) -> str:
    value = row.get(metric, {}).get(region)
    if value is None:
        return "–"
    if metric == "psnr":
        return "copied" if value > 60.0 else f"{value:.1f}"
    return f"{value:.3f}" if abs(value) < 1 else f"{value:.2f}"


def _plate_words(summary: Mapping[str, Any]) -> str:
    return f"Taken from {summary['plate_from']}."


def _labelled(name: str, title: str, labels: Sequence[str], png: bytes, where: str) -> Figure:
    """Clips in one picture, each called by name: `above` for columns, `beside` for rows."""
    source = base64.b64encode(png).decode()
    words = Markup("").join(Markup("<span>{}</span>").format(label) for label in labels)
    drawing = Markup(
        '<div class="clips {}"><div class="names">{}</div><img class="pixels" alt="{}" src="data:image/png;base64,{}"></div>'
    )
    return Figure(name, title, "", drawing.format(where, words, f"{title}: {', '.join(labels)}", source), True)


def _picture(name: str, title: str, caption: str, png: bytes, wide: bool = True) -> Figure:
    source = base64.b64encode(png).decode()
    drawing = Markup('<img class="pixels" alt="{}" src="data:image/png;base64,{}">').format(title, source)
    return Figure(name, title, caption, drawing, wide)


def losses(history: Mapping[str, Sequence[float]]) -> Figure | None:
    """Training losses, smoothed; objectives differ in what they count, so only each line's own course says something."""
    lines = {name: np.asarray(values) for name, values in history.items() if len(values) > 10}
    if not lines:
        return None

    def plot(canvas: Canvas) -> None:
        axis = canvas.subplots()
        for (name, values), colour in zip(lines.items(), COLOURS, strict=False):
            width = max(1, len(values) // 30)
            smooth = np.convolve(values, np.ones(width) / width, "valid")
            axis.plot(np.arange(len(smooth)) + width, smooth, color=colour, label=name)
        log_scale(axis)
        axis.set(xlabel="training step [1]", ylabel="loss [1]")
        canvas.legend(loc="outside upper left", ncols=4)

    return draw(
        "losses", "Training", "Mean loss over a thirtieth of the steps; a line still falling wants more steps.", plot, (5.6, 3.2)
    )
