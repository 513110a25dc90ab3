"""The report of the whole way, from recordings to a policy: our tables beside those of the paper that went this way first."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from edream.calibration.methods import methods
from edream.core.stage import Artifact, stage_of
from edream.practice.naming import brief
from edream.report.calibration import by_horizon, by_joint
from edream.report.overview import ladder
from edream.report.page import mrad, page, picture, share
from edream.report.successes import Evaluated, beside, papers_share

Run = Mapping[str, Artifact]
Row = Sequence[str]
SOURCE = "Wang et al., EmbodieDreamer, arXiv:2507.05198, 2025"
# what the paper reports: RT-1's recordings (calibration, video), a Mobile ALOHA (success, mean of four tasks)
PAPER_FIT = {"error": 0.2161, "annealing_error": 0.2245, "seconds": 1299.92, "annealing_seconds": 12888.43}
PAPER_FVD = {"with": 176.27, "without": 422.73}
PAPER_SUCCESS = {"SFT, 3 views": 0.60, "SFT, 1 view": 0.49, "RL, 1 view": 0.77}
COMPARABLE = {
    "fit": "Ratios can be compared, with care: robot, recordings and processor differ. The paper fits an arm of RT-1's data; here "
    "whole motions are judged that were never fitted. Annealing has 400 steps on the same loss, as SimplerEnv's.",
    "diagnose": "The paper names no effects; there is nothing to compare with.",
    "score": "FVD can be compared only where weights were given for it; otherwise distances are taken in a feature space of our "
    "own, under their own names. Images differ in size and content. Real object pixels are cut from the very image that is "
    "predicted, in the paper as here.",
    "evaluate": "Not comparable in size: the paper's rates are means of four tasks on a real Mobile ALOHA, ours are one task of a "
    "make-believe robot. What can be compared is whether trials help.",
    "together": "The paper's rates are of a real Mobile ALOHA and images of full size, ours of a make-believe robot and the "
    "settings of these runs. What can be compared is how many times as often a policy succeeds after trials.",
    "changed": "The paper's augmentation table was not at hand when this page was written, so none of its numbers stand here; it "
    "uses the same change of scene.",
}
ABOUT = ("evaluate", "score", "diagnose", "fit")  # what a run is about: the first of these that it made


def whole_page(runs: Mapping[str, Run], hidden: Sequence[str], robot: str) -> str:
    """The page as HTML.

    Args:
        runs: run -> need -> artifact, as commands made them.
        hidden: effects that were hidden in the make-believe robot, opened after everything else was done; empty where not known.
        robot: what to call it.
    """
    about: dict[str, list[Run]] = {name: [] for name in ABOUT}
    for run in runs.values():
        about[next(name for name in ABOUT if name in run)].append(run)
    table = list(_together(about["evaluate"]))
    parts = [
        *(_calibration(run) for run in about["fit"]),
        *(_diagnosis(run, hidden) for run in about["diagnose"]),
        *(_video(run) for run in about["score"]),
        *table,
        *_success(about["evaluate"], bool(table)),
    ]
    content = {
        "title": f"{robot}, from recordings to a policy",
        "sentence": " ".join(part["short"] for part in parts if part["short"]),
        "tiles": [tile for part in parts for tile in part["tiles"]],
        "parts": parts,
        "source": SOURCE,
        "made": _made(runs),
    }
    return page("whole.html.j2", content)


def _calibration(run: Run) -> dict[str, Any]:
    summary = run["fit"]["summary.json"]
    judge = summary["error"].get("heldout") or summary["error"]["train"]
    fits = {need: run[need]["summary.json"] for need in run if stage_of(need) == "fit"}
    errors = {one["method"]: one["error"].get("heldout") or one["error"]["train"] for one in fits.values()}
    rows = [
        ("error of the hand, translation [m] + rotation [rad]", *_error_row(errors, summary["method"])),
        ("error / annealing's", *_ratio_row(errors, summary["method"])),
    ]
    beside = methods(run)
    timed = {row["method"]: row["seconds"] for row in beside}
    ours, theirs = timed.get(summary["method"]), timed.get("annealing")
    times = [
        ("time [s]", _text(ours, ".1f"), _text(theirs, ".1f"), *(f"{PAPER_FIT[n]:.0f}" for n in ("seconds", "annealing_seconds"))),
        (
            "time / annealing's",
            _text(ours / theirs if ours and theirs else None, ".3f"),
            "1",
            f"{PAPER_FIT['seconds'] / PAPER_FIT['annealing_seconds']:.3f}",
            "1",
        ),
    ]
    return {
        "name": "Calibration against annealing",
        "sentence": summary["sentence"],
        "short": f"Calibration: {mrad(judge['before']['joint_rmse_rad'])} to {mrad(judge['joint_rmse_rad'])} mrad.",
        "heads": ("", f"ours, {summary['method']}", "ours, annealing", "paper's PhysAligner", "paper's annealing"),
        "rows": rows,
        "times": times,
        "comparable": COMPARABLE["fit"],
        "tiles": [
            ("calibrated, from", mrad(judge["before"]["joint_rmse_rad"]), "mrad"),
            ("to", mrad(judge["joint_rmse_rad"]), "mrad"),
        ],
        "figures": [by_joint(judge, run["ingest"]["summary.json"]["joints"]), by_horizon(judge)],
    }


def _hand(error: Mapping[str, Any] | None) -> float | None:
    return None if error is None else error["translation_m"] + error["rotation_rad"]


def _error_row(errors: Mapping[str, Any], method: str) -> Row:
    ours = [_text(_hand(errors.get(name)), ".4f") for name in (method, "annealing")]
    return *ours, f"{PAPER_FIT['error']:.4f}", f"{PAPER_FIT['annealing_error']:.4f}"


def _ratio_row(errors: Mapping[str, Any], method: str) -> Row:
    ours, theirs = _hand(errors.get(method)), _hand(errors.get("annealing"))
    ratio = ours / theirs if ours is not None and theirs else None
    return _text(ratio, ".3f"), "1", f"{PAPER_FIT['error'] / PAPER_FIT['annealing_error']:.3f}", "1"


def _diagnosis(run: Run, hidden: Sequence[str]) -> dict[str, Any]:
    found = run["diagnose"]
    result = found["summary.json"]
    gap = result["gap"]
    closed = (gap["before_rad"] - gap["after_rad"]) / gap["before_rad"] if gap["before_rad"] else None
    named = ", ".join(f"{one['name']} on {', '.join(one['targets']) or 'all'}" for one in result["effects"]) or "nothing"
    rows = [
        ("hidden in the robot", ", ".join(hidden) or "not known", "–"),
        ("named by edream", named, "–"),
        ("verdict", result["verdict"].replace("_", " "), "–"),
        ("error before, calibrated and nothing added [mrad]", mrad(gap["before_rad"]), "–"),
        ("error after, with what was named [mrad]", mrad(gap["after_rad"]), "–"),
        ("share of the error that is gone", share(closed), "–"),
    ]
    steps = [(one["step"], one["motions_rad"]) for one in found["ladder.json"]]
    return {
        "name": "What the simulator lacked",
        "sentence": result["sentence"],
        "short": f"Diagnosis: {named}.",
        "heads": ("", "ours", "paper's"),
        "rows": rows,
        "times": [],
        "comparable": COMPARABLE["diagnose"],
        "tiles": [("of that error gone by diagnosis", share(closed), "")],
        "figures": [ladder(steps, gap["noise_floor_rad"], result.get("unstable", ()))],
    }


def _video(run: Run) -> dict[str, Any]:
    scored = run["score"]
    rows = {row["label"]: row for row in scored["scores.json"]["rows"]}
    main = next(row for label, row in rows.items() if label.startswith("dream "))
    without, plate = rows.get("no objects"), rows.get("plate")
    measures = (
        ("PSNR [dB], higher is better", "psnr", "all", ".1f"),
        ("PSNR of the object [dB]", "psnr", "object", ".1f"),
        ("SSIM, higher is better", "ssim", "all", ".3f"),
        ("Gabor distance, lower is better", "gabor_distance", "all", ".3f"),
        ("Gabor Fréchet, lower is better", "gabor_frechet", "all", ".3f"),
        ("LPIPS, lower is better", "lpips", "all", ".3f"),
    )
    table: list[Row] = [
        (text, *(_text((row or {}).get(metric, {}).get(region), form) for row in (main, without, plate)), "–", "–")
        for text, metric, region, form in measures
    ]
    fvd = [_text((row or {}).get("fvd", {}).get("all"), ".1f") for row in (main, without, plate)]  # there where weights were given
    table.append(("FVD, lower is better", *fvd, f"{PAPER_FVD['with']:.1f}", f"{PAPER_FVD['without']:.1f}"))
    summary, pictures = scored["summary.json"], scored["scores.json"]["pictures"]
    return {
        "name": "Video with and without object segmentation",
        "sentence": summary["sentence"],
        "short": f"Video: {summary['psnr']:.1f} dB.",
        "heads": ("", "ours, with", "ours, without", "background alone", "paper's, with", "paper's, without"),
        "rows": table,
        "times": [],
        "comparable": COMPARABLE["score"],
        "tiles": [("dreamed video", f"{summary['psnr']:.1f}", "dB")],
        "figures": [picture("moving", "In motion", " | ".join(pictures["moving"]), scored["moving.png"])],
    }


def _together(runs: Sequence[Run]) -> Iterator[dict[str, Any]]:
    """One table of all evaluations on the scene of the demonstrations, where there are several."""
    plain = {run["evaluate"].key: run["evaluate"] for run in runs if _config(run["evaluate"])["evaluate"]["paper"] == "none"}  # type: ignore[attr-defined]
    several = [
        Evaluated(one["summary.json"]["task"], _config(one)["seed"], one["summary.json"]["rates"], one["summary.json"]["paired"])
        for one in plain.values()
    ]
    if len(several) > 1:
        table = beside(several, PAPER_SUCCESS)
        yield {
            **table,
            "name": "How often policies succeed",
            "short": table["sentence"],
            "times": [],
            "comparable": COMPARABLE["together"],
            "tiles": [],
            "figures": [],
        }


def _success(runs: Sequence[Run], together: bool) -> Iterator[dict[str, Any]]:
    """How often policies succeed; and, where some learned with changed scenes, on which scene.

    Args:
        together: whether they stand in one table already, whose sentence is told for them.
    """
    for run in runs:
        summary = run["evaluate"]["summary.json"]
        paper = _config(run["evaluate"])["evaluate"]["paper"]
        changed = paper != "none"
        rows = [_rate_row(row, changed) for row in summary["rates"]]
        last = summary["rates"][-1]
        told = f"{summary['task']}{', paper on the table' if changed else ''}"
        short = f"{told}: {brief(last['name'])} {100 * last['success']['share']:.0f} %."
        where = f"with a sheet of A4 paper on the table ({paper})" if changed else "on the scene of the demonstrations"
        yield {
            "name": f"{summary['task']}: {'augmentation, the scene is changed' if changed else 'supervised, then by trials'}",
            "sentence": f"{summary['sentence']} {where[0].upper()}{where[1:]}.",
            "short": "" if together and not changed else short,
            "heads": ("", "ours [%], Wilson's 95 % interval", "trials", "paper's [%]"),
            "rows": rows,
            "times": [],
            "comparable": COMPARABLE["changed" if changed else "evaluate"],
            "tiles": [(f"success, {told}", f"{100 * last['success']['share']:.0f}", "%")],
            "figures": [],
        }


def _rate_row(row: Mapping[str, Any], changed: bool) -> Row:
    one = row["success"]
    low, high = one["interval"]
    theirs = None if changed else papers_share(row["policy"], row["name"], PAPER_SUCCESS)
    return (
        row["name"],
        f"{100 * one['share']:.1f} [{100 * low:.1f}, {100 * high:.1f}]",
        f"{one['trials']}",
        _text(theirs and 100 * theirs, ".0f"),
    )


def _config(artifact: Any) -> Mapping[str, Any]:
    """The settings that an artifact was made under."""
    return artifact.manifest["fields"]["config"]


def _made(runs: Mapping[str, Run]) -> list[dict[str, Any]]:
    """Every artifact once: what it is, its digest, whose numbers are in it, how long it took."""
    every = {one.key: one for run in runs.values() for one in run.values()}
    return [
        {
            "stage": one.stage,
            "key": one.key,
            "digest": one.digest[:16],
            "numerics": ", ".join(name for name in one.manifest["fields"]["numerics"] if " " not in name) or "–",  # type: ignore[attr-defined]
            "seconds": f"{one.seconds:.1f}",
        }
        for one in every.values()
    ]


def _text(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)
