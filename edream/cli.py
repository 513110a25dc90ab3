"""The command line: composes the config, calls the pipeline, prints. Decides nothing."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from edream import __version__, catalog, cli_complete
from edream.core.errors import EdreamError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="""Make a MuJoCo robot simulator true to recordings.

    Settings are NAME=VALUE words: `robot=so101`, `data=PATH`, `seed=3`. They, and their meaning, stand in the files of `conf/`.
    """,
    epilog="""Examples:

    edream ingest robot=so101 robot.mjcf=so101.xml data=recordings/

    edream status runs=runs

    edream explain lerobot_v3
    """,
)

Overrides = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[NAME=VALUE]...", help="Settings, such as robot=so101 or data=PATH.", autocompletion=cli_complete.settings
    ),
]
Conf = Annotated[Path | None, typer.Option("--conf", metavar="DIR", help="A folder of your own config files, searched first.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
Runs = Annotated[list[str] | None, typer.Argument(metavar="[runs=DIR]", help="The folder of artifacts, where it is not ./runs.")]


def main() -> None:
    """Run the command line; a mistake that a user can mend is one sentence and exit code 2."""
    cli_complete.begin()
    try:
        app()
    except EdreamError as error:
        print(f"edream: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("edream: interrupted; all finished work is kept, and the same command goes on from there.", file=sys.stderr)
        sys.exit(130)


@app.callback(invoke_without_command=True)
def _version(version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False) -> None:
    if version:
        print(f"edream {__version__}")
        raise typer.Exit


@app.command()
def ingest(overrides: Overrides = None, conf: Conf = None, json: Json = False) -> None:
    """Read recordings of any supported format into checked episodes on the robot's joints.

    Example: `edream ingest robot=so101 robot.mjcf=so101.xml data=recordings/`
    """
    run("ingest", ("ingest",), overrides, conf, json)


def _command(stage: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Offer a command where the stage that it makes is there."""
    return app.command() if stage in catalog.names("stages") else lambda function: function


@_command("fit")
def calibrate(overrides: Overrides = None, conf: Conf = None, json: Json = False) -> None:
    """Fit the simulator to recordings; write the calibrated MJCF, its parameters with intervals, and held-out errors.

    With `camera` as the first word: find where the recordings' camera stands, from marked points or from the robot's silhouettes.

    Examples: `edream calibrate robot=so101 robot.mjcf=so101.xml data=recordings/ fit.method=gauss_newton seed=3`,
    `edream calibrate camera robot.mjcf=robot.xml data=recordings/ camera.guess.azimuth=-40`
    """
    if overrides and overrides[0] == "camera":
        run("calibrate camera", ("camera",), overrides[1:], conf, json)
        return
    run("calibrate", ("fit", "report"), [*(overrides or []), "report.of=fit"], conf, json)


@_command("diagnose")
def diagnose(overrides: Overrides = None, conf: Conf = None, json: Json = False) -> None:
    """Find where simulator and recordings disagree, name the missing effect, add it, and prove it on motions held out.

    Example: `edream diagnose robot.mjcf=robot.xml data=recordings/`
    """
    run("diagnose", ("diagnose", "report"), [*(overrides or []), "report.of=diagnose"], conf, json)


@_command("score")
def dream(overrides: Overrides = None, conf: Conf = None, json: Json = False) -> None:
    """Train a model that turns renderings of the calibrated simulator into video like the recordings', and judge it on held-out
    episodes.

    Under torchrun several processes train together; the first one does everything else.

    Examples: `edream dream robot.mjcf=robot.xml data=recordings/ camera.file=cameras.json seed=3`,
    `torchrun --nproc-per-node 2 --no-python edream dream dream=full robot.mjcf=robot.xml data=recordings/`
    """
    _together("dream", "dream", ("score", "report"), [*(overrides or []), "report.of=dream"], conf, json)


@_command("evaluate")
def train_policy(overrides: Overrides = None, conf: Conf = None, json: Json = False) -> None:
    """Train a policy on demonstrations, let it learn from its own trials in the calibrated simulator, and say how often it
    succeeds in the stand-in reality.

    Under torchrun several processes train on the demonstrations together; the first one does everything else.

    Examples: `edream train-policy robot=arm6 task=grab_paper_cup data=demonstrations/ seed=3`,
    `torchrun --nproc-per-node 2 --no-python edream train-policy robot=arm6 task=grab_paper_cup data=demonstrations/`
    """
    _together("train-policy", "sft", ("evaluate", "report"), [*(overrides or []), "report.of=evaluate"], conf, json)


@_command("evaluate")
def export_policy(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The new folder.")],
    of: Annotated[str, typer.Option("--of", metavar="STAGE", help="Whose policy: rl or sft.")] = "rl",
    overrides: Overrides = None,
    conf: Conf = None,
    json: Json = False,
) -> None:
    """Train a policy where that is not done, then write it as a folder to take to a robot: weights, scales, a loop to start from.

    Example: `edream export-policy --out policy/ robot=arm6 task=grab_paper_cup data=demonstrations/`
    """
    from edream import cli_data

    cfg = _compose(overrides, conf)
    with _stdout_for_json(json) as write:
        cli_data.export_policy(cfg, of, out, write if json else None)


@_command("replay")
def replay(
    model: Annotated[Path, typer.Option("--model", metavar="M.xml", help="The MJCF to judge.")],
    data: Annotated[Path, typer.Option("--data", metavar="PATH", help="Recordings, as for ingest.")],
    joints: Annotated[str | None, typer.Option("--joints", metavar="A,B", help="Score these joints only.")] = None,
    until: Annotated[float | None, typer.Option("--until", metavar="SECONDS", help="Score the first seconds only.")] = None,
    hook: Annotated[
        Path | None, typer.Option("--hook", metavar="H.py", help="Python file with make(model) -> step(model, data).")
    ] = None,
    overrides: Overrides = None,
    conf: Conf = None,
    json: Json = False,
) -> None:
    """Open-loop replay error of any MJCF on any recordings.

    Example: `edream replay --model calibrated.xml --data recordings/ --until 40 --json`
    """
    chosen = [f"robot.mjcf={model}", f"data={data}"]
    chosen += [f"replay.joints=[{joints}]"] if joints else []
    chosen += [f"replay.until={until}"] if until is not None else []
    chosen += [f"replay.hook={hook}"] if hook is not None else []
    run("replay", ("replay",), [*(overrides or []), *chosen], conf, json)


@app.command()
def record(overrides: Overrides = None, conf: Conf = None, json: Json = False) -> None:
    """Record a make-believe real robot: a data set as a user brings it, and the truth about it sealed beside.

    Example: `edream record robot=arm6 record.out=recordings record.effects=[payload] seed=1`
    """
    from edream import cli_data

    cfg = _compose(overrides, conf)
    with _stdout_for_json(json) as write:
        cli_data.record_robot(cfg, write if json else None)


@app.command()
def export(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The new folder.")],
    to: Annotated[str, typer.Option("--to", metavar="FORMAT", help="A format that can be written.")] = "lerobot_v3",
    overrides: Overrides = None,
    conf: Conf = None,
    json: Json = False,
) -> None:
    """Write recordings, once ingested, as a data set for other programs.

    Example: `edream export --to lerobot_v3 --out exported/ robot=so101 robot.mjcf=so101.xml data=recordings/`
    """
    from edream import cli_data

    cfg = _compose(overrides, conf)
    with _stdout_for_json(json) as write:
        cli_data.export_episodes(cfg, to, out, write if json else None)


@app.command()
def report(
    overrides: Runs = None,
    open_it: Annotated[bool, typer.Option("--open", help="Show it in a browser.")] = False,
    whole: Annotated[
        str | None, typer.Option("--whole", metavar="NAME", help="One page about all runs NAME-..., beside the paper's numbers.")
    ] = None,
    truth: Annotated[
        Path | None, typer.Option("--truth", metavar="T.json", help="With --whole: the sealed truth, to say what was hidden.")
    ] = None,
    json: Json = False,
) -> None:
    """Write the report of the newest calibration, diagnosis, video or policy anew where it is missing, and print its path.

    Examples: `edream report`, `edream report --open runs=runs`, `edream report --whole reproduce runs=runs`
    """
    from edream import cli_report

    cfg = _compose(overrides, None)
    with _stdout_for_json(json) as write:
        if whole is not None:
            cli_report.whole(cfg, whole, truth, open_it, write if json else None)
        else:
            cli_report.report(cfg, open_it, write if json else None)


@app.command()
def view(
    overrides: Runs = None,
    episode: Annotated[str | None, typer.Option("--episode", metavar="NAME", help="Which one; the first if not given.")] = None,
    save: Annotated[Path | None, typer.Option("--save", metavar="F.rrd", help="Write a Rerun file instead of showing it.")] = None,
    layout: Annotated[Path | None, typer.Option("--layout", metavar="F.json", help="Write a Foxglove layout instead.")] = None,
    json: Json = False,
) -> None:
    """Show an ingested episode in Rerun: commands, positions and images. Foxglove opens the episode file itself.

    Examples: `edream view --episode episode_000000`, `edream view --layout layout.json runs=runs`
    """
    from edream import cli_view

    cfg = _compose(overrides, None)
    with _stdout_for_json(json) as write:
        cli_view.view(cfg, episode, save, layout, write if json else None)


@app.command()
def completion(shell: Annotated[str, typer.Argument(help="bash, zsh or fish.")]) -> None:
    """Print what a shell reads to complete commands, options and settings.

    Example: `edream completion bash >> ~/.bashrc`
    """
    print(cli_complete.script(shell))


@app.command()
def status(overrides: Overrides = None, conf: Conf = None, json: Json = False) -> None:
    """Say what exists, what the given settings would still make, and which field of a key changed.

    Examples: `edream status`, `edream status robot=so101 robot.mjcf=so101.xml data=recordings/`
    """
    from edream import cli_store

    cli_store.status(_compose(overrides, conf), overrides or [], json)


@app.command()
def verify(overrides: Runs = None, json: Json = False) -> None:
    """Check every byte of every artifact; name each file that is not what was written.

    Example: `edream verify runs=runs`
    """
    from edream import cli_store

    cli_store.verify(_compose(overrides, None), json)


@app.command()
def gc(
    overrides: Runs = None,
    forget: Annotated[list[str] | None, typer.Option("--forget", metavar="RUN", help="Forget this run first.")] = None,
    json: Json = False,
) -> None:
    """Remove artifacts that no run names, and what killed processes left.

    Examples: `edream gc`, `edream gc --forget first-try`
    """
    from edream import cli_store

    cli_store.gc(_compose(overrides, None), forget or [], json)


@app.command()
def explain(
    name: Annotated[str, typer.Argument(help="An effect, format, fitter, stage or setting, such as coulomb.")], json: Json = False
) -> None:
    """Explain one thing that edream knows by name.

    Example: `edream explain coulomb`
    """
    from edream import cli_explain

    cli_explain.explain(name, json)


@app.command()
def doctor(json: Json = False) -> None:
    """Say what this machine can run: versions, cores, memory, rendering, and each experiment of conf/experiment.

    Example: `edream doctor`
    """
    from edream import cli_explain

    cli_explain.doctor(json)


def run(command: str, stages: tuple[str, ...], overrides: list[str] | None, conf: Path | None, json: bool) -> None:
    """Make the stages of a command, write down the run, print the summary of the first and the path of each further one."""
    from edream import cli_show, pipeline

    cfg = _compose(overrides, conf)
    with _stdout_for_json(json) as write:
        made, path = pipeline.make_run(command, stages, cfg)
        cli_show.result(made, path, write if json else None)


def _together(command: str, shared: str, stages: tuple[str, ...], words: list[str], conf: Path | None, json: bool) -> None:
    """The same where torchrun started several processes: all but the first help it to train one stage, and end with it."""
    from edream import pipeline
    from edream.vision.together import joined

    with joined() as rank:
        if rank:
            pipeline.follow(shared, _compose(words, conf))
        else:
            run(command, stages, words, conf, json)


def _compose(overrides: list[str] | None, conf: Path | None) -> Any:
    from edream import config, pipeline

    cfg = config.compose(overrides or [], conf)
    if conf is not None or any(override.startswith(("+", "~")) for override in overrides or []):
        pipeline.check_settings(cfg)
    return cfg


@contextmanager
def _stdout_for_json(json: bool) -> Iterator[Callable[[str], object]]:
    """Whatever a library prints while a command works goes to stderr, so that --json prints one object alone."""
    out = sys.stdout
    if json:
        sys.stdout = sys.stderr
    try:
        yield lambda text: print(text, file=out, flush=True)
    finally:
        sys.stdout = out
