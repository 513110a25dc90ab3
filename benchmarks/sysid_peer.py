"""mujoco.sysid on the problem of an `Objective`: its own optimiser, rollouts and residuals; our parameters as its modifiers."""

import copy

import mujoco
import numpy as np

from edream.core.effect import joint_index
from edream.sim.differences import STEP
from edream.sim.objective import Objective
from edream.sim.start import start_velocity


class ModelFields:
    """One model's fields with the leading axis that effects write along."""

    count = 1

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model

    def __getitem__(self, name: str) -> np.ndarray:
        return getattr(self.model, name)[None]


def fit_with_sysid(objective: Objective, iterations: int = 20) -> tuple[np.ndarray, float]:
    """Values that mujoco.sysid finds, and the seconds of motion that it simulated.

    Raises:
        ImportError: mujoco's `sysid` extra is not installed.
    """
    from mujoco import sysid

    if not hasattr(sysid, "optimize"):
        raise ImportError("mujoco.sysid needs the 'bench' extra")
    simulated, space = objective.simulated, objective.simulated.space
    spec = simulated.spec()
    joints = (
        [j for j, counts in zip(simulated.robot.joints, objective.joints, strict=True) if counts]
        if objective.joints is not None
        else list(simulated.robot.joints)
    )
    for joint in joints:
        spec.add_sensor(name=f"{joint}_q", type=mujoco.mjtSensor.mjSENS_JOINTPOS, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint)
    base = spec.compile()
    params = sysid.ParameterDict()
    for i, name in enumerate(space.names):
        params.add(sysid.Parameter(name, float(space.to_unit(space.start())[i]), 0.0, 1.0))
    built = 0

    def build(chosen: object, _spec: object) -> mujoco.MjModel:
        nonlocal built
        built += 1
        model = copy.copy(base)
        numbers = simulated.quantities(space.from_unit(np.clip(chosen.as_vector(), 0.0, 1.0))[None], [{}])  # type: ignore[attr-defined]
        for placement, values in zip(simulated.placements, numbers, strict=True):
            for target in placement.targets:
                placement.effect.write(ModelFields(model), target, values)
        return model

    sequences = [_sequence(sysid, objective, spec, base, number, joints) for number in range(len(objective.windows))]
    residual = sysid.build_residual_fn(models_sequences=sequences, build_model=build)
    # its own finite-difference step, 1.5e-8, is lost in the kinks of dry friction, so it is given ours
    options = {"max_iters": iterations, "eps": STEP}
    found, _ = sysid.optimize(initial_params=params, residual_fn=residual, optimizer="mujoco", verbose=False, **options)
    length = float(np.mean([window.times[-1] for window in objective.windows]))
    return space.from_unit(np.clip(found.as_vector(), 0.0, 1.0)), built * length


def _sequence(sysid, objective: Objective, spec: mujoco.MjSpec, model: mujoco.MjModel, number: int, joints: list[str]):
    window = objective.windows[number]
    episode, data, step = window.episode, mujoco.MjData(model), model.opt.timestep
    indices = [joint_index(model, joint) for joint in episode.joints]
    for index, position, speed in zip(indices, window.measured[0], start_velocity(window), strict=True):
        data.qpos[index["qpos"]], data.qvel[index["dof"]] = position, speed
    clock = np.arange(0.0, window.times[-1], step)
    rows = np.maximum(np.searchsorted(episode.command_times, clock + episode.times[window.first] + 1e-9, side="right") - 1, 0)
    control = np.zeros((len(clock), model.nu))
    control[:, [index["ctrl"] for index in indices]] = episode.command[rows]
    wanted = [episode.joints.index(joint) for joint in joints]
    measured = sysid.TimeSeries.from_names(window.times, window.measured[:, wanted], model, names=None)
    start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
    return sysid.ModelSequences("robot", spec, f"window{number}", start, sysid.TimeSeries(clock, control), measured)
