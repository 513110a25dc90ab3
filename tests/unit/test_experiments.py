"""Sizes that belong together, and the page about a whole chain."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from edream import config, pipeline
from edream.cli import app
from edream.core.errors import EdreamError

NAMES = ("tiny", "so101", "xl330", "paper", "video")


def ask(*words: str) -> dict:
    result = CliRunner().invoke(app, [*words, "--json"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.mark.parametrize("name", NAMES)
def test_every_setting_of_an_experiment_is_read_by_a_stage(name: str) -> None:
    cfg = config.compose([f"experiment={name}"])
    pipeline.check_settings(cfg)
    assert "experiment" not in cfg


def test_there_is_no_experiment_that_no_test_knows() -> None:
    assert {path.stem for path in (config.conf_folder() / "experiment").glob("*.yaml")} == set(NAMES)


def test_the_command_line_has_the_last_word_over_an_experiment() -> None:
    cfg = config.compose(["robot=pan_tilt", "experiment=tiny", "fit.seconds=7"])
    assert cfg.robot.name == "pan_tilt" and cfg.fit.seconds == 7 and cfg.evaluate.starts < 200


def test_the_paper_is_as_large_as_the_paper() -> None:
    cfg = config.compose(["experiment=paper"])
    assert (cfg.render.width, cfg.render.height) == (320, 256) and cfg.dream.frames == 16 and cfg.record.episodes == 50
    assert cfg.robot.name == "cobot" and len(cfg.record.cell.cameras) == 3
    assert "rollouts.eyes=dreamed" in cfg.evaluate.of[-1], "trials are in the dreamed simulator"
    assert cfg.sft.train.steps * cfg.sft.batch == 1000 * cfg.record.episodes * (1 - cfg.sft.held)


def test_doctor_says_what_of_each_experiment_can_run_here() -> None:
    told = ask("doctor")
    assert set(told["experiments"]) == set(NAMES)
    if told["gpu"] is None:
        assert "ask for a GPU" in told["experiments"]["paper"] and "GPU" not in told["experiments"]["tiny"]
    assert "robot.mjcf=PATH" in told["experiments"]["so101"]
    assert "calibrate" not in told["experiments"]["video"], "there is no robot to calibrate"


def test_one_page_about_several_runs_is_made_once_and_stands_beside_the_paper(tmp_path: Path) -> None:
    ask("record", "robot=pan_tilt", f"record.out={tmp_path}/rec", "record.motions=3", "record.seconds=2", "seed=1")
    place = [f"runs={tmp_path}/runs"]
    small = ["robot=pan_tilt", "fit.seconds=4", "fit.stretch=2", "fit.search.annealing_steps=3", "seed=1"]
    ask("calibrate", *small, *place, f"data={tmp_path}/rec", "fit.compare=[annealing]", "run=small-calibrate")
    first = ask("report", "--whole", "small", "--truth", f"{tmp_path}/rec.truth.json", *place)
    again = ask("report", "--whole", "small", "--truth", f"{tmp_path}/rec.truth.json", *place)
    assert first == again and first["runs"] == ["small-calibrate"]
    page = Path(first["report"]).read_text()
    assert "Calibration against annealing" in page and "12888" in page and "0.963" in page and 'src="http' not in page
    assert page.count("<time>") > 3, "how long something took lies outside of the digest"
    made = ask("status", *place)["runs"]["small"]["made"]
    ask("gc", *place)
    assert len(made) == 1 and Path(first["report"]).exists()


def test_runs_that_do_not_exist_are_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    with pytest.raises(EdreamError, match="run=mine-NAME"):
        CliRunner().invoke(app, ["report", "--whole", "mine", f"runs={tmp_path}/runs"], catch_exceptions=False)
