"""What a written model does in plain MuJoCo, without edream: the check of the error that a diagnosis states.

python benchmarks/stock_replay.py DIAGNOSIS.json recordings

DIAGNOSIS.json is what `edream diagnose ... --json` printed; recordings is the folder of tables (`time`, `command_JOINT`,
`position_JOINT`) that it was made from, such as `benchmarks/stranger.py` writes. Nothing of edream is imported; the hook is the
written file.
"""

import argparse
import importlib.util
import json
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np


def main() -> None:
    """Compare the stated error on motions never fitted with that of a plain loop."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("diagnosis", type=Path)
    parser.add_argument("recordings", type=Path)
    given = parser.parse_args()
    told = json.loads(given.diagnosis.read_text(encoding="utf-8"))
    model = mujoco.MjModel.from_xml_path(told["model"])
    squares = []
    for name in told["motions"]["proof"]:
        table = np.genfromtxt(given.recordings / f"{name}.csv", delimiter=",", names=True)
        squares.append(np.mean(replayed(model, hook_of(told["hook"], model), table)[1:] ** 2))
        print(f"{name}: {1e3 * np.sqrt(squares[-1]):.3f} mrad")
    print(f"plain MuJoCo {1e3 * np.sqrt(np.mean(squares)):.3f} mrad, stated {1e3 * told['gap']['after_rad']:.3f} mrad")


def hook_of(path: str | None, model: mujoco.MjModel) -> Callable[[mujoco.MjModel, mujoco.MjData], None]:
    """The written hook, or one that does nothing."""
    if path is None:
        return lambda model, data: None
    spec = importlib.util.spec_from_file_location("hook", path)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{path} is no Python file with make(model).")
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    return hook.make(model)


def replayed(model: mujoco.MjModel, step: Callable[[mujoco.MjModel, mujoco.MjData], None], table: np.ndarray) -> np.ndarray:
    """Simulated minus measured [rad], (T, J); from the measured pose and speed on, which a recording may begin under way."""
    joints = [name.removeprefix("position_") for name in table.dtype.names if name.startswith("position_")]
    command, measured = (np.stack([table[f"{kind}_{joint}"] for joint in joints], 1) for kind in ("command", "position"))
    times = table["time"] - table["time"][0]
    ids = [model.joint(joint).id for joint in joints]
    servo = [next(a for a in range(model.nu) if model.actuator_trnid[a, 0] == i) for i in ids]
    sensors = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, f"{joint}_measured") for joint in joints]
    data = mujoco.MjData(model)
    gear = model.actuator_gear[servo, 0]  # an encoder before a gear counts its turns
    data.qpos[model.jnt_qposadr[ids]] = measured[0] / gear
    data.qvel[model.jnt_dofadr[ids]] = np.polyfit(times[:3], measured[:3], 1)[0] / gear
    out = [measured[0]]
    for now in times[1:]:
        while data.time < now - 0.5 * model.opt.timestep:
            data.ctrl[servo] = command[np.searchsorted(times, data.time + 1e-9, side="right") - 1]
            step(model, data)
            mujoco.mj_step(model, data)
        encoders = [data.sensordata[model.sensor_adr[s]] if s >= 0 else np.nan for s in sensors]
        out.append(np.where(np.isnan(encoders), data.qpos[model.jnt_qposadr[ids]], encoders))
    return np.array(out) - measured


if __name__ == "__main__":
    main()
