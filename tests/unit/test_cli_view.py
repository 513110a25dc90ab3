"""Looking at episodes, and completing commands."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from edream import cli_view
from edream.cli import app
from edream.cli_complete import SHELLS, script, settings
from edream.core.errors import EdreamError
from edream.ingest import mcap_file


def ask(*words: str) -> dict:
    result = CliRunner().invoke(app, [*words, "--json"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("view")
    ask("record", "robot=pan_tilt", f"record.out={folder}/rec", "record.motions=2", "record.seconds=1", "seed=1")
    ask("ingest", "robot=pan_tilt", f"data={folder}/rec", f"runs={folder}/runs")
    return folder / "runs"


def test_the_shipped_layout_is_that_of_the_arm_with_its_camera() -> None:
    joints = [f"joint{i}" for i in range(1, 7)] + ["gripper"]
    assert json.loads(cli_view.SHIPPED.read_text()) == cli_view.foxglove_layout(joints, ["cam_high"])


def test_a_layout_plots_topics_that_the_episode_has_and_shows_every_panel(runs: Path, tmp_path: Path) -> None:
    told = ask("view", f"runs={runs}", "--layout", f"{tmp_path}/layout.json")
    layout = json.loads((tmp_path / "layout.json").read_text())
    assert len(layout["configById"]) == 2 and all(name in json.dumps(layout["layout"]) for name in layout["configById"])
    topics = mcap_file.peek(Path(told["mcap"]))
    for panel in layout["configById"].values():
        for path in panel["paths"]:
            assert path["value"].partition(".")[0] in {topic for topic, *_ in topics.channels}, path


def test_an_episode_becomes_a_rerun_file(runs: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="Rerun is not installed: pip install 'edream[view]'")
    ask("view", f"runs={runs}", "--save", f"{tmp_path}/one.rrd", "--episode", "episode_1")
    assert (tmp_path / "one.rrd").stat().st_size > 1000


def test_an_episode_that_does_not_exist_is_one_sentence_with_the_nearest(runs: Path) -> None:
    with pytest.raises(EdreamError, match="Did you mean 'episode_1'"):
        CliRunner().invoke(app, ["view", f"runs={runs}", "--episode", "episode_l"], catch_exceptions=False)


@pytest.mark.parametrize(
    ("begun", "expected"),
    [("robot=so", ["robot=so101"]), ("fit.me", ["fit.method="]), ("fit.method=ann", ["fit.method=annealing"]), ("expe", None)],
)
def test_settings_are_completed(begun: str, expected: list[str] | None) -> None:
    assert settings(begun) == (expected or ["experiment.", "experiment="])


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_gets_a_script_that_names_the_command(shell: str) -> None:
    assert "edream" in script(shell) and "_EDREAM_COMPLETE" in script(shell)


def test_bash_completes_a_setting_as_typed_on_a_command_line(tmp_path: Path) -> None:
    program = "import sys; sys.argv[0] = 'edream'; from edream.cli import main; main()"
    (tmp_path / "edream").write_text(f'#!/bin/sh\nexec {sys.executable} -c "{program}" "$@"\n')
    (tmp_path / "edream").chmod(0o755)
    (tmp_path / "script").write_text(script("bash"))
    typed = 'COMP_WORDS=(edream calibrate robot=so1); COMP_CWORD=2; _edream_completion edream; echo "${COMPREPLY[@]}"'
    root = Path(__file__).resolve().parents[2]
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHONPATH": str(root)}
    done = subprocess.run(["bash", "-c", f". {tmp_path}/script; {typed}"], env=environment, capture_output=True, text=True)
    assert done.stdout.strip() == "robot=so101", done.stderr
