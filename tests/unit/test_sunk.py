"""A number that is searched by its logarithm and sank, while others were still far off, comes up again."""

import mujoco
import numpy as np
import pytest

from edream.core.episode import Episode
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Settings, prepare
from edream.sim.robot import RobotModel

TRUE = {"a": (67.0, 2.4, 0.12, 0.0155), "b": (54.0, 1.35, 0.135, 0.0244)}  # gain, damping, dry friction, rotor
PUBLISHED = {"a": (50.0, 2.5, 0.1, 0.005), "b": (50.0, 1.3, 0.1, 0.005)}


def arm(numbers: dict[str, tuple[float, float, float, float]], step: float) -> RobotModel:
    """Two links that swing in a plane, the lower one heavy at its end."""
    joints = {n: f'<joint name="{n}" axis="0 1 0" frictionloss="{f}" armature="{i}"/>' for n, (_, _, f, i) in numbers.items()}
    servos = "".join(f'<position joint="{n}" kp="{p}" kv="{d}"/>' for n, (p, d, _, _) in numbers.items())
    return RobotModel(
        "arm",
        f"""<mujoco><option timestep="{step}"/><worldbody><body>{joints["a"]}
        <inertial pos="0 0 -0.13" mass="0.29" diaginertia="0.0008 0.0009 0.0001"/><body pos="0 0 -0.18">{joints["b"]}
        <inertial pos="0 0 -0.174" mass="1.12" diaginertia="0.0024 0.0038 0.0015"/></body></body></worldbody>
        <actuator>{servos}</actuator></mujoco>""",
    )


def motion(number: int) -> Episode:
    model = arm(TRUE, 5e-4).model
    rng, times = np.random.default_rng(number), np.arange(0.0, 6.0, 0.02)
    poses = rng.uniform(-1.5, 1.5, (9, 2))
    at = np.linspace(0.0, len(poses) - 1.0, len(times))
    command = np.stack([np.interp(np.clip(1.4 * at - 0.2 * np.floor(at), 0.0, at.max()), range(len(poses)), c) for c in poses.T], 1)
    data, position = mujoco.MjData(model), np.empty((len(times), 2))
    data.qpos[:] = data.ctrl[:] = command[0]
    mujoco.mj_step(model, data, 4000)
    for row, told in enumerate(command):
        position[row] = data.qpos
        data.ctrl[:] = told
        mujoco.mj_step(model, data, 40)
    return Episode(f"motion_{number}", ("a", "b"), times, position + rng.normal(0.0, 3e-4, position.shape), times, command)


def test_a_rotor_that_sank_in_the_first_steps_comes_up_again() -> None:
    problem = prepare(arm(PUBLISHED, 5e-4), [motion(n) for n in range(6)], Settings())
    found = fit_nuisance(problem)
    assert found.rms < 1.2 * problem.floor
    assert found.space.mapping(found.values)["armature.inertia[a]"] == pytest.approx(TRUE["a"][3], rel=0.2)
