"""Steps per second of the sweep against a bare C loop over the same model on the same threads.

    python benchmarks/bench_steps.py [--robot arm6|cobot] [--threads N] [--repeat N]

The bare loop is `mujoco.rollout` (a C++ thread pool around mj_step) with the commands laid out beforehand. The sweep simulates as
many windows of the same length under as many parameter sets, and includes everything that it does for its table: fields per
simulation, commands at their own times, restarts at measured states, sampling at measured times. Both are timed in turn, several
times, and the medians are compared. Neither runs MuJoCo's stopwatch.
"""

import argparse
import json
import os
import time
from collections.abc import Callable

import mujoco
import numpy as np
from mujoco import rollout as bare

from edream import config
from edream.calibration.settings import RobotSettings, SpaceSettings, simulated_robot
from edream.calibration.windows import simulate
from edream.core.episode import Episode
from edream.sim.quiet import quiet
from edream.sim.window import Window


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="arm6")
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=0.5)
    options = parser.parse_args()
    robot = RobotSettings(config.conf_folder().parent / "edream" / "robots" / f"{options.robot}.xml").load()
    simulated = simulated_robot(robot, SpaceSettings(("servo_gain", "viscous", "coulomb", "armature"), (("all",),)))
    rng = np.random.default_rng(0)
    windows = [window(robot.joints, robot.model, options.seconds, rng) for _ in range(16)]
    unit = rng.uniform(0.3, 0.7, (32, len(simulated.space)))
    step = simulated.model.opt.timestep
    count, steps = len(unit) * len(windows), int(np.ceil(windows[0].times[-1] / step))
    ours, theirs, cpu_ours, cpu_theirs = [], [], [], []
    for _ in range(options.repeat):
        for wall, cpu, work in (
            (ours, cpu_ours, lambda: simulate(simulated, unit, windows, options.threads)),
            (theirs, cpu_theirs, lambda: loop(simulated.model, windows, len(unit), steps, options.threads)),
        ):
            seconds, processor = timed(work)
            wall.append(seconds)
            cpu.append(processor)
    result = {
        "robot": options.robot,
        "threads": options.threads,
        "simulations": count,
        "steps_each": steps,
        "sweep_steps_per_s": count * steps / float(np.median(ours)),
        "bare_steps_per_s": count * steps / float(np.median(theirs)),
        "ratio": float(np.median(theirs) / np.median(ours)),
        "ratio_of_cpu_time": float(np.median(cpu_theirs) / np.median(cpu_ours)),
    }
    print(json.dumps(result, indent=1))


def window(joints: tuple[str, ...], model: mujoco.MjModel, seconds: float, rng: np.random.Generator) -> Window:
    """A recorded stretch at 50 Hz: smooth motion from a random pose."""
    times = np.arange(0.0, seconds + 0.02, 0.02)
    middle = np.array([np.mean(model.joint(j).range) for j in joints])
    reach = np.array([np.ptp(model.joint(j).range) / 6 for j in joints])
    position = middle + reach * np.sin(rng.uniform(1, 4, len(joints)) * times[:, None] + rng.uniform(0, 6, len(joints)))
    return Window(Episode("bench", joints, times, position, times, position + 0.02), 0, len(times) - 1)


def loop(model: mujoco.MjModel, windows: list[Window], sets: int, steps: int, threads: int) -> np.ndarray:
    """`mj_step` in a thread pool, states out."""
    data = [mujoco.MjData(model) for _ in range(threads)]
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    states, control = [], []
    for one in windows:
        data[0].qpos[:] = one.measured[0]
        full = np.empty(size)
        mujoco.mj_getState(model, data[0], full, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        rows = np.minimum((np.arange(steps) * model.opt.timestep / 0.02).astype(int), len(one.times) - 1)
        states += [full] * sets
        control += [one.episode.command[rows]] * sets
    with quiet():
        return bare.rollout(model, data, np.array(states), np.array(control), nstep=steps)[0]


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds by the clock and seconds of processor that a call takes; the second holds on a machine that others use too."""
    start, processor = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - start, time.process_time() - processor


if __name__ == "__main__":
    main()
