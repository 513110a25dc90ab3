"""The command that shows an episode: in Rerun, or a layout for Foxglove."""

import json as json_
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from edream import cli_show, pipeline
from edream.core.episode import Episode
from edream.core.errors import EdreamError, unknown_name

SHIPPED = Path(__file__).parent / "foxglove.json"  # for arm6 with cam_high


def view(cfg: DictConfig, name: str | None, save: Path | None, layout: Path | None, write: Callable[[str], object] | None) -> None:
    """Show an episode of the newest ingest in Rerun, or write a Foxglove layout for it.

    Args:
        cfg: the composed config; of it only the store's place counts.
        name: of the episode; the first where None.
        save: a Rerun file to write instead of showing.
        layout: a Foxglove layout to write instead.
        write: prints the JSON object, or None to print for a person.

    Raises:
        EdreamError: nothing was ingested, there is no such episode, or Rerun is not installed.
    """
    from edream.ingest.episode_read import read_episode

    store = pipeline.open_store(cfg)
    ingested = [one for one in store.artifacts() if one.stage == "ingest"]
    if not ingested:
        raise EdreamError(f"There is no episode in {store.root} yet; run edream ingest first.")
    files = {Path(file).stem: file for file in ingested[-1] if file.endswith(".mcap")}
    if name is not None and name not in files:
        raise unknown_name("episode", name, files)
    path = ingested[-1].path(files[name or min(files)])
    episode = read_episode(path)
    told = {"episode": episode.name, "mcap": str(path.absolute())}
    if layout is not None:
        layout.write_text(json_.dumps(foxglove_layout(episode.joints, tuple(episode.videos)), indent=1) + "\n")
        told["layout"] = str(layout.absolute())
    else:
        told |= _rerun(episode, save)
    if write is not None:
        write(json_.dumps(told, indent=2))
    else:
        cli_show.table(told)


def foxglove_layout(joints: Sequence[str], cameras: Sequence[str]) -> dict[str, Any]:
    """A layout for an episode file: cameras to the left, to the right a plot a joint of what was commanded and measured."""
    panels: dict[str, Any] = {}
    for camera in cameras:
        panels[f"Image!{camera}"] = {
            "imageMode": {"imageTopic": f"/camera/{camera}/image", "calibrationTopic": f"/camera/{camera}/calibration"},
            "foxglovePanelTitle": camera,
        }
    for index, joint in enumerate(joints):
        paths = [
            {"value": f"/{topic}.joints[{index}].position", "label": label, "enabled": True, "timestampMethod": "receiveTime"}
            for topic, label in (("joint_commands", "command"), ("joint_states", "measured"))
        ]
        panels[f"Plot!{joint}"] = {
            **{"paths": paths, "foxglovePanelTitle": f"{joint} [rad or m]", "xAxisVal": "timestamp", "isSynced": True},
            **{"showLegend": True, "legendDisplay": "floating", "showYAxisLabels": True},
            "showXAxisLabels": index == len(joints) - 1,
        }
    left, right = [f"Image!{one}" for one in cameras], [f"Plot!{one}" for one in joints]
    sides = [_stacked(side) for side in (left, right) if side]
    root = sides[0] if len(sides) == 1 else {"direction": "row", "first": sides[0], "second": sides[1], "splitPercentage": 40}
    about = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}}
    return {"configById": panels, **about, "layout": root}


def _stacked(panels: Sequence[str]) -> Any:
    if len(panels) == 1:
        return panels[0]
    share = 100.0 / len(panels)
    return {"direction": "column", "first": panels[0], "second": _stacked(panels[1:]), "splitPercentage": round(share, 2)}


def _rerun(episode: Episode, save: Path | None) -> Mapping[str, str]:
    """Log an episode to Rerun: each joint's command and position, each camera's images."""
    try:
        import rerun as rr  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        why = "edream view needs Rerun, which is not installed; pip install 'edream[view]', or give --layout."
        raise EdreamError(why) from error
    rr.init(f"edream {episode.name}", spawn=save is None)
    if save is not None:
        rr.save(save)
    rows = (("measured", episode.times, episode.position), ("command", episode.command_times, episode.command))
    for what, times, values in rows:
        for column, joint in enumerate(episode.joints):
            clock = [rr.TimeColumn("time", duration=times)]
            rr.send_columns(f"joints/{joint}/{what}", indexes=clock, columns=rr.Scalars.columns(scalars=values[:, column]))
    for camera, video in episode.videos.items():
        for time, image in zip(video.times, video.frames(), strict=True):
            rr.set_time("time", duration=float(time))
            rr.log(f"cameras/{camera}", rr.Image(image))
    rr.disconnect()
    return {"saved": str(save.absolute())} if save is not None else {"shown": "in Rerun"}
