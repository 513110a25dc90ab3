"""From demonstrations to a report of how often a policy succeeds, end to end, at the smallest size."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from omegaconf import DictConfig
from typer.testing import CliRunner

from edream import config, pipeline
from edream.cli import app
from edream.core.errors import EdreamError
from edream.ingest.episode_read import read_episode
from edream.practice.bundle import RunningPolicy, write_bundle

SMALL = [
    "policy.height=32",
    "policy.width=32",
    "policy.options.dim=32",
    "policy.options.heads=2",
    "policy.options.feedforward=64",
    "policy.options.encoder=1",
    "policy.options.widths=[8,16,16]",
    "policy.chunk=30",
    "policy.stride=30",
    "sft.train.steps=6",
    "sft.checkpoint=2",
    "sft.batch=8",
    "sft.held=0.34",
    "sft.twins=true",
    "sft.change.share=0.5",
    "rollouts.eyes=composite",
    "rollouts.model=published",
    "rollouts.starts=2",
    "rollouts.samples=2",
    "rollouts.shard=2",
    "rollouts.noise.action=0.5",
    "rank.margin=0",
    "rl.train.steps=2",
    "rl.checkpoint=1",
    "rl.held=1",
    "rl.batch=2",
    "evaluate.starts=2",
    "evaluate.films=1",
    "executor.workers=1",
]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, rendering: None) -> Path:
    """Three demonstrations with video."""
    from edream.calibration.settings import RobotSettings
    from edream.reality.cell_look import CellLook
    from edream.record import RecordConfig
    from edream.record_task import record_task

    out = tmp_path_factory.mktemp("policy") / "demos"
    robot = config.read(config.compose(["robot=arm6"]).robot, RobotSettings, "robot").load()
    record_task(robot, "grab_paper_cup", RecordConfig(out, episodes=3, cell=CellLook(height=32, width=32)), seed=1)
    return out


def words(recorded: Path, runs: Path, *more: str) -> list[str]:
    place = [
        "robot=arm6",
        "task=grab_paper_cup",
        f"data={recorded}",
        f"runs={runs}",
        "seed=1",
        "report.of=evaluate",
        f"camera.file={recorded}.cameras.json",
        f"render.scene={recorded}.scene.json",
        f"rollouts.plate={recorded}.plate.png",
    ]
    return [*place, *SMALL, *more]


def settings(recorded: Path, runs: Path, *more: str) -> DictConfig:
    return config.compose(words(recorded, runs, *more))


@pytest.fixture(scope="module")
def made(recorded: Path, tmp_path_factory: pytest.TempPathFactory):
    cfg = settings(recorded, tmp_path_factory.mktemp("runs"), "rl.rounds=2")
    return cfg, pipeline.make_run("train-policy", ("evaluate", "report"), cfg)[0]


def test_train_policy_goes_from_demonstrations_to_a_page_with_rates_and_films(made) -> None:
    artifacts = made[1]
    rows = artifacts["evaluate"]["summary.json"]["rates"]
    assert [row["policy"] for row in rows] == ["sft", "rl"] and all(row["success"]["trials"] == 2 for row in rows)
    films = [name for name in artifacts["evaluate"] if name.endswith(".mcap")]
    episode = read_episode(artifacts["evaluate"].path(films[0]))
    assert len(films) == 2 and episode.videos["cam_high"].height == 32 and episode.notes["outcome"] in ("success", "failure")
    page = artifacts["report"]["report.html"]
    assert page.count("data:image/png;base64,") >= 2 and "Wilson" in page and 'src="http' not in page


def test_runs_that_judged_policies_stand_in_one_table_and_the_same_run_twice_counts_once(made, recorded: Path) -> None:
    runs = Path(made[0].runs)
    for name, first in (("together-1", 30000), ("together-again", 30000), ("together-2", 30002)):
        more = ("rl.rounds=2", f"run={name}", f"evaluate.first={first}", "evaluate.films=0", "evaluate.of=[sft]")
        pipeline.make_run("train-policy", ("evaluate", "report"), settings(recorded, runs, *more))
    told = CliRunner().invoke(app, ["report", "--whole", "together", f"runs={runs}", "--json"], catch_exceptions=False)
    page = Path(json.loads(told.stdout)["report"]).read_text()
    assert "mean of 2 evaluations" in page and page.count(">seed 1</td>") == 2


def test_every_policy_that_learned_from_trials_says_how(made, recorded: Path) -> None:
    """An ablation's page had none of its rounds."""
    of = 'evaluate.of=["rl rl.rounds=1","rl"]'
    more = ("rl.rounds=2", "run=rounds", "evaluate.films=0", of)
    page = pipeline.make_run("train-policy", ("evaluate", "report"), settings(recorded, Path(made[0].runs), *more))[0]["report"]
    text = page["report.html"]
    assert text.count('id="figure-ratios-') == 2
    assert "RL, 1 view: 2 rounds of trials: success" in text and "RL, rl.rounds=1, 1 view: Round 1 of" in text
    assert text.count("<td>RL, rl.rounds=1, 1 view</td>") == 2 and text.count("<td>RL, 1 view</td>") == 3, "its rate and its rounds"


def test_a_round_with_nothing_to_learn_from_keeps_the_policy_and_the_rest_is_judged(made, recorded: Path) -> None:
    """One simulator of an ablation in which no trial succeeds ended the whole of it."""
    more = ("rl.rounds=1", "run=idle", "evaluate.films=0", "rank.margin=10")
    artifacts = pipeline.make_run("train-policy", ("evaluate", "report"), settings(recorded, Path(made[0].runs), *more))[0]
    idle = pipeline.chain(pipeline.open_store(made[0]), artifacts["evaluate"])["rl"]
    before = pipeline.chain(pipeline.open_store(made[0]), idle)["rollouts"]["policy.safetensors"]
    assert all(np.array_equal(before[name], idle["policy.safetensors"][name]) for name in before)
    (row,) = idle["history.json"]
    assert (row["pairs"], row["steps"], row["kept_step"]) == (0, 0, 0) and row["before"] == row["kept"]
    assert "0 of 4 trials succeeded, and none went better" in idle["summary.json"]["sentence"]
    said = "Nothing was learned in round 1: 0 of 4 trials succeeded"
    assert said in artifacts["evaluate"]["summary.json"]["sentence"] and "figure-ratios-" not in artifacts["report"]["report.html"]


def test_a_round_is_played_by_the_policy_of_the_round_before(made) -> None:
    cfg, artifacts = made
    first = pipeline.make("rl", settings_of(cfg, 1))
    rolled = pipeline.chain(pipeline.open_store(cfg), artifacts["rl"])["rollouts"]
    assert [row["round"] for row in artifacts["rl"]["history.json"]] == [1, 2]
    before, played = first["policy.safetensors"], rolled["policy.safetensors"]
    assert all(np.array_equal(before[name], played[name]) for name in before)
    starts = set(rolled["outcomes.parquet"]["start"].to_pylist())
    assert starts == {10002, 10003}, "each round has starts of its own"


def settings_of(cfg: DictConfig, rounds: int) -> DictConfig:
    return pipeline.under(cfg, f"rl rl.rounds={rounds}")


def test_a_second_run_makes_nothing_anew_and_gc_keeps_every_round(made) -> None:
    cfg, artifacts = made
    again = pipeline.make_run("train-policy", ("evaluate", "report"), cfg)[0]
    assert {name: one.key for name, one in again.items()} == {name: one.key for name, one in artifacts.items()}
    store = pipeline.open_store(cfg)
    store.gc()
    assert store.find("rl", pipeline.make("rl", settings_of(cfg, 1)).key) is not None


@pytest.mark.parametrize("stage", ["sft", "rl rl.rounds=1"])
def test_a_training_that_is_killed_goes_on_and_gives_the_same_weights(made, recorded: Path, tmp_path: Path, stage: str) -> None:
    name, *changes = stage.split(" ")
    runs = without(made, tmp_path / "runs", name, "evaluate", "report")
    program = f"import sys; from edream import config, pipeline; pipeline.make({name!r}, config.compose(sys.argv[1:]))"
    command = [sys.executable, "-c", program, *words(recorded, runs, *changes)]
    killed = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True, env=os.environ)
    until = time.monotonic() + 100
    while not list((runs / name).glob(".work-*/train-0000000/000000/manifest.json")) and time.monotonic() < until:
        assert killed.poll() is None or killed.returncode == 0, killed.stderr and killed.stderr.read()
        time.sleep(0.005)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.wait()
    assert not list((runs / name).glob("*/manifest.json")), "it was killed in the middle of its training"
    whole = pipeline.make(name, settings_of(made[0], 1) if changes else made[0])
    weights = pipeline.make(name, settings(recorded, runs, *changes))
    assert weights.key == whole.key and weights["policy.safetensors"].keys() == whole["policy.safetensors"].keys()
    assert all(
        np.array_equal(weights["policy.safetensors"][one], whole["policy.safetensors"][one])
        for one in weights["policy.safetensors"]
    )


def without(made, runs: Path, *stages: str) -> Path:
    """A copy of the store in which some stages were never made."""
    shutil.copytree(made[0].runs, runs, ignore=lambda folder, names: stages if Path(folder) == Path(made[0].runs) else ())
    return runs


@pytest.mark.slow  # tests/unit/test_policy.py has the same of a policy that is not trained first
def test_evaluation_with_four_workers_gives_the_numbers_of_one(made, recorded: Path, tmp_path: Path) -> None:
    runs = without(made, tmp_path / "runs", "evaluate", "report")
    many = pipeline.make("evaluate", settings(recorded, runs, "rl.rounds=2", "executor.workers=4", "evaluate.shard=1"))
    one = made[1]["evaluate"]
    assert len(many["outcomes.parquet"]) == 4 and many["outcomes.parquet"].equals(one["outcomes.parquet"])
    films = [name for name in one if name.endswith(".png")]
    assert films and all(many[name] == one[name] for name in films)


def test_a_bundle_does_what_the_policy_does(made, tmp_path: Path) -> None:
    write_bundle(made[1]["rl"], tmp_path / "bundle", 9.0)
    loop = (tmp_path / "bundle" / "run_policy.py").read_text()
    compile(loop, "run_policy.py", "exec")
    assert "range(round(9 * policy.about.rate))" in loop, "a trial of nine seconds is not cut short"
    policy = RunningPolicy(tmp_path / "bundle")
    image = np.random.default_rng(0).integers(0, 255, (48, 48, 3)).astype(np.uint8)
    first = [policy.act(np.zeros(7), {"cam_high": image}) for _ in range(3)]
    policy.begin()
    assert np.array_equal(policy.act(np.zeros(7), {"cam_high": image}), first[0]) and np.isfinite(first).all()
    with pytest.raises(EdreamError, match="cam_high"):
        policy.begin()
        policy.act(np.zeros(7), {"cam_low": image})
    with pytest.raises(EdreamError, match=r"joint positions have the shape \(6,\).*\(7,\)"):
        policy.act(np.zeros(6), {"cam_high": image})
    with pytest.raises(EdreamError, match=r"further numbers have the shape \(9,\)"):
        policy.act(np.zeros(7), {"cam_high": image}, np.zeros(9))


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("evaluate.truth=none.json", "export-policy"),
        ("task=grab_cup", "grab_paper_cup"),
        ("robot=pan_tilt", "'pan_tilt' has no workcell"),
        ("policy.rl=tpoo", "tpo_paper"),
        ("policy.kind=acd", "no policy 'acd'"),
        ("rl.rounds=0", r"evaluate\.of=\[sft\]"),
        ("rl.held=0", r"rl\.held is 0"),
        ("policy.cameras=[cam_high,cam_side]", "one camera for rollouts.eyes=composite"),
        ("rollouts.eyes=state", r"policy\.cameras is null; expected \[\]"),
        ("rollouts.plate=none.png", "nothing at none.png"),
        ("render.scene=null", "sft.twins needs render.scene"),
    ],
)
def test_what_is_wrong_for_a_late_stage_is_told_before_anything_is_made(
    recorded: Path, tmp_path: Path, wrong: str, told: str
) -> None:
    cfg = settings(recorded, tmp_path / "runs", wrong)
    with pytest.raises(EdreamError, match=told):
        pipeline.make_run("train-policy", ("evaluate", "report"), cfg)
    assert not list(tmp_path.glob("runs/*/*")), "no stage has worked for it"


@pytest.mark.slow
def test_two_processes_of_torchrun_train_one_policy_and_one_of_them_does_the_rest(made, recorded: Path) -> None:
    asked = words(
        recorded,
        Path(str(made[0].runs)),
        "rl.rounds=1",
        'evaluate.of=[sft,"sft sft.twins=false sft.change.share=0",rl]',
        "evaluate.films=0",
    )
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", "--no-python", sys.executable]
    command += ["-c", "from edream.cli import main; main()", "train-policy", "--json", *asked]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280, env=os.environ | {"OMP_NUM_THREADS": "1"})
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout)
    assert Path(told["report"]).is_file() and len(told["rates"]) == 3
    store = pipeline.open_store(made[0])
    trained = [one["summary.json"]["weights_digest"] for one in store.artifacts() if one.stage == "sft"]
    assert len(set(trained)) == len(trained) == 3, "by one process with twins, by two with twins, by one without"


def test_training_goes_on_from_a_policy_in_a_folder_and_refuses_one_of_another_form(made, recorded: Path, tmp_path: Path) -> None:
    write_bundle(made[1]["rl"], tmp_path / "bundle", 9.0)
    on = (f"sft.start={tmp_path / 'bundle'}", "sft.train.steps=2", "sft.train.rate=1e-9", "sft.hidden=0.5")
    first = pipeline.make("sft", settings(recorded, Path(made[0].runs), *on))
    same = (f"sft.start={made[1]['rl'].path('policy.json').parent}", *on[1:])
    assert pipeline.make("sft", settings(recorded, Path(made[0].runs), *same)).key == first.key, "the same policy, elsewhere"
    begun = first["policy.safetensors"]
    before = made[1]["rl"]["policy.safetensors"]
    assert begun.keys() == before.keys() and all(np.allclose(begun[name], before[name], atol=1e-6) for name in before)
    other = pipeline.make("sft", made[0])["policy.safetensors"]
    assert not all(np.allclose(begun[name], other[name], atol=1e-6) for name in before), "the comparison must be able to fail"
    with pytest.raises(EdreamError, match=r"sft\.start=.*bundle holds a policy with shape"):
        pipeline.make("sft", settings(recorded, Path(made[0].runs), *on, "policy.chunk=40"))
    with pytest.raises(EdreamError, match=r"nothing at .*policy\.(json|safetensors)"):
        pipeline.make("sft", settings(recorded, Path(made[0].runs), f"sft.start={tmp_path}"))
