"""Channels become joints, in SI units, or a sentence says why not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edream import config, pipeline
from edream.core.episode import Recording
from edream.core.errors import EdreamError
from edream.ingest.mapping import MappingConfig, map_recording, selected
from tests.recordings import sample_recording

JOINTS = ("shoulder", "elbow")


def renamed(*names: str) -> Recording:
    return replace(sample_recording(), channels=names, command_channels=names)


@pytest.mark.parametrize("names", [("elbow.pos", "shoulder.pos"), ("left/elbow", "left/shoulder"), ("Elbow", "Shoulder")])
def test_channels_are_found_by_name_whatever_surrounds_it(names: tuple[str, ...]) -> None:
    recording = renamed(*names)
    episode = map_recording(recording, JOINTS, MappingConfig())
    np.testing.assert_array_equal(episode.position, recording.position[:, ::-1])
    np.testing.assert_array_equal(episode.command, recording.command[:, ::-1])


def test_channels_without_names_are_taken_in_order() -> None:
    recording = renamed()
    np.testing.assert_array_equal(map_recording(recording, JOINTS, MappingConfig()).position, recording.position)


def test_foreign_names_are_never_taken_in_order_by_themselves() -> None:
    with pytest.raises(EdreamError, match=r"no measured channel for joint 'shoulder'.*What exists: x, y"):
        map_recording(renamed("x", "y"), JOINTS, MappingConfig())
    assert map_recording(renamed("x", "y"), JOINTS, MappingConfig(by="order")).joints == JOINTS


def test_an_explicit_mapping_is_followed() -> None:
    episode = map_recording(renamed("x", "y"), JOINTS, MappingConfig(channels={"shoulder": "y", "elbow": "x"}))
    np.testing.assert_array_equal(episode.position, sample_recording().position[:, ::-1])


def test_a_mistyped_joint_in_the_mapping_is_named_with_the_nearest() -> None:
    with pytest.raises(EdreamError, match="Did you mean 'elbow'"):
        map_recording(sample_recording(), JOINTS, MappingConfig(units={"elbwo": "deg"}))


def test_degrees_become_radians_and_normalised_values_are_scaled() -> None:
    recording = sample_recording()
    mapping = MappingConfig(unit="deg", units={"elbow": "normalised"}, scale={"elbow": 2.0}, offset={"elbow": -0.5})
    episode = map_recording(recording, JOINTS, mapping)
    np.testing.assert_allclose(episode.position[:, 0], np.deg2rad(recording.position[:, 0]))
    np.testing.assert_allclose(episode.position[:, 1], 2.0 * recording.position[:, 1] - 0.5)


def test_a_normalised_joint_without_scale_is_refused() -> None:
    with pytest.raises(EdreamError, match=r"give ingest.mapping.scale.shoulder"):
        map_recording(sample_recording(), JOINTS, MappingConfig(unit="normalised"))


def test_both_clocks_start_at_the_first_measurement() -> None:
    recording = sample_recording()
    late = replace(recording, times=recording.times + 100.0, command_times=recording.command_times + 99.99)
    episode = map_recording(late, JOINTS, MappingConfig())
    assert episode.times[0] == 0.0 and episode.command_times[0] == pytest.approx(-0.01, abs=1e-9)


def test_channels_that_the_robot_lacks_are_noted() -> None:
    recording = sample_recording()
    wider = replace(recording, channels=(*JOINTS, "tail"), position=np.hstack([recording.position, recording.position[:, :1]]))
    assert map_recording(wider, JOINTS, MappingConfig()).notes["unmapped_channels"] == "tail"


def test_an_ambiguous_joint_is_refused() -> None:
    with pytest.raises(EdreamError, match="may be any of the measured channels left/elbow, right/elbow"):
        map_recording(renamed("left/elbow", "right/elbow"), ("elbow",), MappingConfig())


def test_video_only_needs_no_joints_and_no_commands() -> None:
    recording = replace(sample_recording(), command=np.zeros((0, 0)), command_times=np.zeros(0), command_channels=())
    assert map_recording(recording, JOINTS, MappingConfig(by="none")).joints == ()
    with pytest.raises(EdreamError, match="no commanded positions"):
        map_recording(recording, JOINTS, MappingConfig())


def test_recordings_are_selected_by_name_or_task() -> None:
    recording = replace(sample_recording("episode_000003"), notes={"task": "chirp_sweep"})
    assert selected(recording, ()) and selected(recording, ("*_000003",)) and selected(recording, ("chirp*",))
    assert not selected(recording, ("sine*",))


def test_degrees_for_a_gripper_that_slides_are_refused(tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text("t,a\n0,0\n1,1\n")
    words = ["robot=arm6", f"data={tmp_path}", f"runs={tmp_path}/runs", "ingest.mapping.unit=deg"]
    with pytest.raises(EdreamError, match=r"'gripper' slides, and is given in 'deg'; give ingest\.mapping\.units\.gripper=m or mm"):
        pipeline.make("ingest", config.compose(words))
    with pytest.raises(EdreamError, match=r"'joint1' turns, and is given in 'mm'"):
        pipeline.make("ingest", config.compose([*words[:3], "ingest.mapping.unit=mm"]))
