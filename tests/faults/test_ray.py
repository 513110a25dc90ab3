"""A Ray cluster of two machines, one of which dies: the same bytes as processes of one machine.

python -m pytest -m slow tests/faults/test_ray.py     (needs edream[ray])
"""

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import small_stages

from edream import config, pipeline
from edream.calibration.settings import RobotSettings
from edream.core.errors import EdreamError
from edream.executor import Ray, create
from edream.reality.cell_look import CellLook
from edream.reality.look import Look
from edream.record import RecordConfig, record
from edream.record_task import record_task
from edream.stages import render
from edream.store import Store
from tests.rendering import pan_tilt
from tests.test_dream_pipeline import settings as dream_settings
from tests.test_policy_pipeline import settings as policy_settings

ROOT = Path(__file__).parents[2]
SHARDS = 60
SIMULATED = ["robot=pan_tilt", "fit.method=surrogate", "fit.seconds=4", "fit.stretch=2", "sweep.sets=16"]
SIMULATED += ["sweep.rounds=1", "sweep.windows=8", "sweep.blocks=8", "seed=1"]


def test_an_executor_that_does_not_exist_is_one_sentence() -> None:
    with pytest.raises(EdreamError, match="ray"):
        create("raj", 0)


@pytest.fixture(scope="module")
def cluster() -> Iterator:
    """Two machines with two cores each, as far as Ray can tell; jobs begin on the first."""
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'edream[ray]'")
    from ray.cluster_utils import Cluster

    patch = pytest.MonkeyPatch()
    patch.setenv("PYTHONPATH", f"{ROOT}{os.pathsep}{Path(small_stages.__file__).parent}")
    patch.setenv("OMP_NUM_THREADS", "1")
    for patience in ("gcs_server_request_timeout_seconds", "raylet_start_wait_time_s", "py_gcs_connect_timeout_s"):
        patch.setenv(f"RAY_{patience}", "180")  # a busy machine begins a cluster slowly
    own = pipeline.stage
    patch.setattr(pipeline, "stage", lambda name: small_stages.STAGES.get(name) or own(name))
    cluster = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 2, "object_store_memory": 10**8, "include_dashboard": False}
    )
    cluster.second = cluster.add_node(num_cpus=2, object_store_memory=10**8)
    cluster.wait_for_nodes(timeout=180)
    yield cluster
    ray.shutdown()
    cluster.shutdown()
    patch.undo()


def settings(runs: Path, address: str | None, kind: str = "ray"):
    cfg = small_stages.settings(runs, shards=SHARDS, run="test")
    cfg.executor = {"kind": kind, "workers": 0 if kind == "ray" else 1, "address": address}
    return cfg


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_mistake_in_a_task_far_away_is_the_same_one_sentence(cluster) -> None:
    with pytest.raises(EdreamError) as told:
        list(Ray(cluster.address).run(small_stages.fails, range(5)))
    assert str(told.value) == "Job 2 cannot be done."


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_machines_make_the_bytes_of_one_and_the_death_of_one_changes_nothing(cluster, tmp_path) -> None:
    here = pipeline.make_run("total", ("total",), settings(tmp_path / "here", None, "local"))[0]["total"]
    whole = pipeline.make_run("total", ("total",), settings(tmp_path / "whole", cluster.address))[0]["total"]
    assert whole.digest == here.digest
    runs, died = tmp_path / "killed", threading.Event()

    def kill() -> None:
        while len(list(runs.glob("grow/.work-*/values/0*"))) < 5:
            time.sleep(0.01)
        cluster.remove_node(cluster.second, allow_graceful=False)
        died.set()

    killer = threading.Thread(target=kill)
    killer.start()
    made = pipeline.make_run("total", ("total",), settings(runs, cluster.address))[0]["total"]
    killer.join()
    assert died.is_set() and made.digest == here.digest
    assert Store(runs).verify() == []
    files = [{p.relative_to(r): p.read_bytes() for p in r.glob("grow/*/values.parquet")} for r in (tmp_path / "here", runs)]
    assert files[0] == files[1], "the same bytes, not only the same meaning"


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_calibration_on_a_cluster_has_the_digests_of_one_machine(tmp_path) -> None:
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'edream[ray]'")
    program = "from edream.cli import main; main()"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}

    def ask(*words: str) -> dict:
        done = subprocess.run([sys.executable, "-c", program, *words, "--json"], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    ask("record", "robot=pan_tilt", f"record.out={tmp_path}/rec", "record.motions=3", "record.seconds=3", "seed=1")
    found = []
    for words in ([], ["executor=ray", "executor.address=null"]):
        runs = tmp_path / ("far" if words else "here")
        ask("calibrate", *SIMULATED, *words, f"data={tmp_path}/rec", f"runs={runs}", "fit.search.descent_steps=5")
        found.append({one.stage: one.digest for one in Store(runs).artifacts()})
    assert found[0] == found[1]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_rendering_and_dreamed_video_on_a_cluster_have_the_digests_of_one_machine(
    cluster, rendering, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, own = [], Ray.run
    monkeypatch.setattr(Ray, "run", lambda self, task, jobs: (asked.append(len(jobs)), own(self, task, jobs))[1])
    monkeypatch.setattr(render, "MANY", 1)  # images from which on it takes more than one process
    look = RecordConfig(tmp_path / "rec", motions=5, seconds=1.6, rate=10.0, video=True, look=Look(48, 48))
    record(pan_tilt(), look, seed=2)
    near = ("executor.workers=1", "dream.baseline=false", "dream.ablation=false", "score.metrics=[psnr,ssim]")
    far = (*near[1:], "executor=ray", f"executor.address={cluster.address}")
    digests = []
    for place, words in (("here", near), ("far", far)):
        cfg = dream_settings(tmp_path / "rec", tmp_path / place, *words)
        digests.append([pipeline.make(stage, cfg).digest for stage in ("render", "score")])
    assert len(asked) == 2 and min(asked) >= 5, "five episodes are rendered there, and every kind of video is made there"
    assert digests[0] == digests[1]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_trials_of_policies_on_a_cluster_have_the_digests_of_one_machine(cluster, rendering, tmp_path) -> None:
    demos = tmp_path / "demos"
    robot = config.read(config.compose(["robot=arm6"]).robot, RobotSettings, "robot").load()
    record_task(robot, "grab_paper_cup", RecordConfig(demos, episodes=3, cell=CellLook(height=32, width=32)), seed=1)
    small = ("rl.rounds=1", "evaluate.of=[sft]", "evaluate.films=0", "sft.twins=false", "rollouts.shard=1")
    far = ("executor=ray", f"executor.address={cluster.address}", "executor.workers=0")
    here = policy_settings(demos, tmp_path / "runs", *small)
    there = policy_settings(demos, tmp_path / "runs", *small, *far)
    for stage in ("rollouts", "evaluate"):
        made = pipeline.make(stage, here)
        shutil.rmtree(made.folder)
        assert pipeline.make(stage, there).digest == made.digest
