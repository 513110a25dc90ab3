"""The hook file: what an MJCF cannot say, as a few lines of Python that need numpy and MuJoCo alone."""

import inspect
import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from edream.sim.friction import way
from edream.sim.limits import let_through, limits_of
from edream.sim.memory import at_rest, recent
from edream.sim.rotor import has_rotor, wind_up
from edream.sim.simulation import SimulatedRobot, late_last
from edream.sim.start import SETTLED

STATEFUL = "MuJoCo starts filters, delays and integrals at zero; this file starts them at the command that holds, as at rest."
GEARED = "Motors behind gears that give or have play, <joint>_motor, are put where their gears carry the load at time 0."

HEAD = '''"""{title}

Plain loop:   step = make(model)
              for each step: data.ctrl[:] = command; step(model, data); mujoco.mj_step(model, data)
Many at once: step = make_batch(batch)   # a mujoco.batch.Batch of this model
              for each step: set ctrl; step(); batch.step()

Call it after ctrl is set and before each step. It owns model.dof_frictionloss and data.qfrc_applied.
{starts}
"""

import weakref

import mujoco
import numpy as np

'''

BODY = '''

# law, where it acts, with which numbers
CALLS = {calls}


class One:
    """One MjData, seen as a batch of one."""

    recent, let_through, way, past = recent, let_through, way, staticmethod(at_rest)

    def __init__(self, model, data, limits, memory):
        self.time, self.step, self.memory = np.array([data.time]), model.opt.timestep, memory
        self.qpos, self.qvel, self.ctrl = data.qpos[None], data.qvel[None], data.ctrl[None]
        self.qfrc_bias, self.actuator_force = data.qfrc_bias[None], data.actuator_force[None]
        self.constraint = data.qfrc_constraint[None]
        self.gear_torque = (data.qfrc_smooth + data.qfrc_bias + data.qfrc_constraint - model.dof_armature * data.qacc)[None]
        self.gain, self.speed_gain, self.limits = -model.actuator_biasprm[None, :, 1], -model.actuator_biasprm[None, :, 2], limits
        self.friction, self.torque = model.dof_frictionloss[None], data.qfrc_applied[None]


class Many:
    """A mujoco.batch.Batch: the same names, one row a simulation."""

    recent, let_through, way, past = recent, let_through, way, staticmethod(at_rest)

    def __init__(self, batch):
        bind = batch.bind
        self.step, self.memory = batch.get_model(0).opt.timestep, {{}}
        self.clock, self.bias = bind("time"), batch.expand("actuator_biasprm")
        self.qpos, self.qvel, self.ctrl = bind("qpos"), bind("qvel"), bind("ctrl")
        self.qfrc_bias, self.actuator_force = bind("qfrc_bias"), bind("actuator_force")
        self.friction, self.torque = batch.expand("dof_frictionloss"), bind("qfrc_applied")
        self.smooth, self.constraint, self.qacc = bind("qfrc_smooth"), bind("qfrc_constraint"), bind("qacc")
        self.armature = batch.expand("dof_armature")
        self.limits = limits_of(batch.get_model(0), batch.expand("actuator_forcerange"))

    @property
    def time(self):
        return self.clock.reshape(len(self.clock))

    @property
    def gear_torque(self):
        return self.smooth + self.qfrc_bias + self.constraint - self.armature * self.qacc

    @property
    def gain(self):
        return -self.bias[:, :, 1]

    @property
    def speed_gain(self):
        return -self.bias[:, :, 2]


def addresses(model, joint):
    """Where a joint, the actuator that drives it and that actuator's motor lie in MuJoCo's arrays."""
    link, drives = model.joint(joint).id, [i for i in range(model.njnt) if model.joint(i).name in (joint, joint + "_motor")]
    for actuator in range(model.nactuator):
        motor = model.actuator_trnid[actuator, 0]
        if model.actuator_trntype[actuator] in (0, 1) and motor in drives and model.actuator_ctrlnum[actuator]:
            return {{
                "joint": link,
                "dof": model.jnt_dofadr[link],
                "qpos": model.jnt_qposadr[link],
                "actuator": actuator,
                "ctrl": model.actuator_ctrladr[actuator],
                "force": model.actuator_outadr[actuator],
                "drive": model.jnt_dofadr[motor],
                "drive_qpos": model.jnt_qposadr[motor],
            }}
    raise ValueError(f"no actuator drives joint {{joint!r}}")


def calls(model):
    """Every law with its addresses in this model."""
    out = []
    for law, place, values in CALLS:
        first, _, second = place.partition("<-")
        index = addresses(model, first) if first else {{}}
        if second:
            index |= {{"other_" + key: value for key, value in addresses(model, second).items()}}
        out.append((law, index, values))
    return out


def apply(state, base, laws):
    """Friction and torque of this step."""
    state.friction[:] = base
    state.torque[:] = 0.0
    for law, index, values in laws:
        law(state, index, values)


def begin(model, data):
    """Start filters at the command, delays with it, and derived quantities at the current state."""
    for actuator in range(model.nactuator):
        if not model.actuator_ctrlnum[actuator]:
            continue
        command, dynamics = data.ctrl[model.actuator_ctrladr[actuator]], int(model.actuator_dyntype[actuator])
        filters = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
        slew = dynamics == int(mujoco.mjtDyn.mjDYN_PID) and model.actuator_dynprm[actuator, 1] > 0.0
        if dynamics in filters or slew:
            data.act[model.actuator_actadr[actuator]] = command
        samples = model.actuator_history[actuator, 0]
        if samples:
            values = model.actuator_historyadr[actuator] + 2 + samples
            data.history[values : values + samples] = command
    for sensor in range(model.nsensor):
        samples, joint, gear = model.sensor_history[sensor, 0], model.sensor_objid[sensor], 1.0
        geared = model.sensor_type[sensor] == int(mujoco.mjtSensor.mjSENS_ACTUATORPOS)
        if geared:
            joint, gear = model.actuator_trnid[joint, 0], model.actuator_gear[joint, 0]
        if samples and (geared or model.sensor_type[sensor] == int(mujoco.mjtSensor.mjSENS_JOINTPOS)):
            values = model.sensor_historyadr[sensor] + 2 + samples
            data.history[values : values + samples] = gear * data.qpos[model.jnt_qposadr[joint]]
{gears}    moving = data.qvel.copy()
    data.qvel[:] = 0.0
    mujoco.mj_forward(model, data)
    for actuator in range(model.nactuator):
        first, count = model.actuator_actadr[actuator], model.actuator_actnum[actuator]
        pid = int(model.actuator_dyntype[actuator]) == int(mujoco.mjtDyn.mjDYN_PID)
        if pid and count > (model.actuator_dynprm[actuator, 1] > 0.0):
            motor = model.joint(model.actuator_trnid[actuator, 0])
            dof = model.joint(motor.name.removesuffix("_motor")).dofadr[0]
            lacking = data.qfrc_bias[dof] - data.qfrc_passive[dof] - data.qfrc_actuator[motor.dofadr[0]]
            ki, kp = model.actuator_gainprm[actuator, 0], -model.actuator_biasprm[actuator, 1]
            data.act[first + count - 1] += lacking * -np.expm1(-ki * {settled} / kp) / ki
    data.qvel[:] = moving
    mujoco.mj_forward(model, data)


# of a model or a batch: its own dry friction [N m] and what a step wrote over it, known to all hook files and to one loaded again
BASES = vars(mujoco).setdefault("friction_under_hooks", weakref.WeakKeyDictionary())


def base_of(moved, friction):
    """The own dry friction of a model or a batch and what was written over it; what is neither is a new friction of its own."""
    if moved not in BASES or not np.array_equal(BASES[moved][1], friction):
        BASES[moved] = friction.copy(), friction.copy()
    return BASES[moved]


def make(model):
    """A function step(model, data) to be called before each mujoco.mj_step."""
    laws, last, memory = calls(model), [np.inf], {{}}
    limits = limits_of(model, model.actuator_forcerange[None])
    base, written = base_of(model, model.dof_frictionloss)

    def step(model, data):
        if data.time < last[0] or data.time == 0.0:
            model.dof_frictionloss[:] = base
            begin(model, data)
            memory.clear()
        last[0] = data.time
        apply(One(model, data, limits, memory), base, laws)
        written[:] = model.dof_frictionloss

    return step


def make_batch(batch):
    """A function step() to be called before each batch.step(), for simulations of one model that have been started."""
    state, laws, last = Many(batch), calls(batch.get_model(0)), [-np.inf]
    base, written = base_of(batch, state.friction)

    def step():
        if state.time[0] < last[0]:  # started again
            state.memory.clear()
        last[0] = state.time[0]
        apply(state, base, laws)
        written[:] = state.friction

    return step
'''

GEARS = """    for _, index, _ in calls(model):
        if index and index["drive"] != index["dof"]:
            data.qpos[index["drive_qpos"]], data.qvel[index["drive"]] = data.qpos[index["qpos"]], data.qvel[index["dof"]]
    mujoco.mj_forward(model, data)
    gears = model.tendon_stiffness[None], model.tendon_range[None], model.tendon_lengthspring[None], data.eq_active[None]
    wind_up(model, data.qpos[None], (data.qfrc_bias - data.qfrc_passive)[None], *gears)
"""


def hook_text(simulated: SimulatedRobot, numbers: Sequence[Mapping[str, np.ndarray]], model: mujoco.MjModel) -> str | None:
    """The hook file of a robot with values, or None where a plain loop needs none.

    A model without hooks gets one too where a filter or delay must begin at the first command: MuJoCo begins them at zero.

    Args:
        simulated: the robot and its effects.
        numbers: each placement's quantities, (1,) each.
        model: the emitted model, compiled.
    """
    pairs = [(p, values) for p, values in late_last(zip(simulated.placements, numbers, strict=True)) if p.effect.hook is not None]
    delayed = bool(model.actuator_history[:, 0].any() or (model.nsensor and model.sensor_history[:, 0].any()))
    filtered = bool(np.isin(model.actuator_dyntype[model.actuator_ctrlnum > 0], (2, 3, int(mujoco.mjtDyn.mjDYN_PID))).any())
    if not pairs and not delayed and not filtered:
        return None
    sources, rows = {}, []
    for placement, values in pairs:
        hook: Any = placement.effect.hook
        sources[hook.__name__] = _plain(inspect.getsource(hook))
        listed = "{" + ", ".join(f'"{name}": {float(value[0])!r}' for name, value in values.items()) + "}"
        rows += [f'({hook.__name__}, "{target}", {listed})' for target in placement.targets or ("",)]
    title = f"What an MJCF cannot say of {simulated.robot.name}: {', '.join(sources) or 'where its filters and delays begin'}."
    calls = "[\n" + "".join(f"    {row},\n" for row in rows) + "]" if rows else "[]"
    geared = any(has_rotor(model, joint) for joint in simulated.robot.joints)
    said = [text for text, true in ((STATEFUL, delayed or filtered), (GEARED, geared)) if true]
    head = HEAD.format(title=title, starts="\n".join(said)).replace('\n\n"""', '\n"""')
    shared = (limits_of, let_through, recent, at_rest, way, *((wind_up,) if geared else ()))
    sources |= {one.__name__: "\n" + re.sub(r"( ->|:) (Any|None)\b", "", inspect.getsource(one)) for one in shared}
    laws = "\n\n".join(sources[name] for name in sorted(sources))
    return head + laws + BODY.format(calls=calls, gears=GEARS if geared else "", settled=SETTLED)


def _plain(source: str) -> str:
    """A hook's source without its type annotations, which name edream's types."""
    source = textwrap.dedent(source)
    first, _, rest = source.partition("\n")
    return f"\n{first.partition('(')[0]}(state, index, values):\n{rest}"
