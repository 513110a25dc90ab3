import json
import subprocess
import sys

import pytest

from edream import cli, cli_show

PROGRAM = [sys.executable, "-c", "import sys; sys.argv[0] = 'edream'; from edream.cli import main; main()"]


def edream(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*PROGRAM, *arguments], capture_output=True, text=True, timeout=120)


def test_help_shows_examples() -> None:
    said = edream("--help").stdout
    assert "Examples" in said and "edream ingest" in said


def test_help_imports_nothing_but_what_prints_it() -> None:
    """What makes help slow is what it imports; how long that takes is the machine's affair."""
    code = "import sys; from typer.testing import CliRunner; from edream.cli import app; CliRunner().invoke(app, ['--help'])"
    others = "{name.split('.')[0] for name in sys.modules} - set(sys.stdlib_module_names)"
    said = subprocess.run([sys.executable, "-c", f"{code}; print(*({others}))"], capture_output=True, text=True, check=True)
    loaded = set(said.stdout.split())
    printers = {"typer", "rich", "pygments", "markdown_it", "mdurl", "shellingham", "annotated_doc", "attr", "click"}
    assert {"edream", "typer"} <= loaded <= {"__main__", "_distutils_hack", "edream", *printers}


@pytest.mark.parametrize("command", [one.callback.__name__.replace("_", "-") for one in cli.app.registered_commands])
def test_every_command_shows_an_example(command) -> None:
    from typer.testing import CliRunner

    said = CliRunner().invoke(cli.app, [command, "--help"], env={"COLUMNS": "200"}).output
    assert f"edream {command}" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["ingest", "robto=so101"], "Did you mean 'robot'"),
        (["ingest", "robot=arm6"], "'data' is not set"),
        (["ingest", "robot=arm6", "data=no/such/folder"], "There is nothing at no/such/folder"),
        (["explain", "lerobot_v33"], "Did you mean 'lerobot_v3'"),
        (["explain", "fit.metod"], "Did you mean 'fit.method'"),
        (["verify", "runs=no/such/folder"], "There is no folder no/such/folder"),
        (["ingest", "robot.mjcf=none.xml", "data=."], "There is no robot model at none.xml"),
        (["status", "--conf", "no/such/folder"], "There is no config folder"),
    ],
)
def test_a_users_mistake_is_one_sentence_and_exit_code_2(arguments, said) -> None:
    done = edream(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("edream: ") and said in done.stderr
    assert "Traceback" not in done.stderr and len(done.stderr.strip().splitlines()) == 1


def test_a_mistyped_option_is_exit_code_2() -> None:
    done = edream("status", "--jsn")
    assert done.returncode == 2 and "No such option" in done.stderr


def test_version_is_the_packages() -> None:
    from edream import __version__

    assert edream("--version").stdout.strip() == f"edream {__version__}"


def test_json_is_one_object_and_nothing_else(tmp_path) -> None:
    done = edream("status", f"runs={tmp_path}", "--json")
    assert json.loads(done.stdout) == {"runs": {}, "artifacts": []}
    assert done.stderr == ""


def test_explain_tells_what_a_setting_is_and_starts_from() -> None:
    (found,) = json.loads(edream("explain", "fit.search.annealing_steps", "--json").stdout)["settings"]
    assert found["value"] == "400"
    assert edream("explain", "fit.holdout").stdout.startswith("fit.holdout (setting)")


def test_explain_prints_the_docstring_of_an_entry() -> None:
    said = json.loads(edream("explain", "ingest", "--json").stdout)
    assert said["entries"][0]["catalog"] == "stages"
    assert "MCAP" in said["entries"][0]["text"]


def test_a_rate_in_a_table_reads_as_a_person_says_it(capsys: pytest.CaptureFixture[str]) -> None:
    rate = {"successes": 138, "trials": 200, "share": 0.69, "interval": (0.6228, 0.7499)}
    cli_show.table({"sentence": "Done.", "rates": [{"name": "SFT, 1 view", "success": rate, "grasp": None}]})
    assert "69.0 % [62.3, 75.0], 138 of 200" in capsys.readouterr().out
