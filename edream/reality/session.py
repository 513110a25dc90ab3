"""The make-believe robot moving among things: contacts by MuJoCo, torques of actuators and friction by reality's own equations.

Each step of at most 1 ms applies the servo's torque, hidden effects included, and what passive effects add, as a joint force; dry
friction is a bound on each joint's friction force. A bound that differs by direction, -u <= f <= d, is the same as half the sum
either way and a constant force of half the difference.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float

from edream.core.errors import EdreamError
from edream.reality.body_effects import Payload
from edream.reality.plant import Moment, Plant, Term
from edream.reality.servo_effects import ActuatorDelay
from edream.reality.truth import Truth

MEMORY = 0.2  # of encoder values and commands, longer than any delay [s]


class Session:
    """One trial of the robot; its dry friction, armature and damping are written into the model.

    Args:
        model: robot and things, compiled after `hollow`.
        names: joints of the robot, in the order of its nominal model.
        truth: what is true of it.
        nominal: the nominal robot.
    """

    def __init__(self, model: mujoco.MjModel, names: Sequence[str], truth: Truth, nominal: mujoco.MjModel) -> None:
        self.model, self.data, self.step = model, mujoco.MjData(model), float(model.opt.timestep)
        self.qpos = np.array([model.joint(name).qposadr[0] for name in names])
        self.dofs = np.array([model.joint(name).dofadr[0] for name in names])
        self.terms = truth.terms(nominal)
        self.plant = true_plant(truth, nominal, self.terms)
        for term in self.terms:
            term.start((1, len(names)))
        model.opt.gravity = self.plant.gravity
        model.dof_armature[self.dofs], model.dof_damping[self.dofs] = self.plant.armature, self.plant.damping
        model.dof_frictionloss[self.dofs] = np.maximum(self.plant.frictionloss, 1e-9)
        used = {
            n: [t for t in self.terms if getattr(type(t), n) is not getattr(Term, n)] for n in ("error", "drive", "dry", "passive")
        }
        self._error, self._drive, self._dry, self._passive = (used[n] for n in ("error", "drive", "dry", "passive"))
        self._setpoints = [_Setpoint(t, self.step) for t in self.terms if type(t).setpoint is not Term.setpoint]
        self._recording = [t for t in self.terms if type(t).record is not Term.record]
        self._sprung = bool(self.plant.stiffness.any())
        self._column = np.full(model.nv, -1)
        self._column[self.dofs] = np.arange(len(names))
        self.load = np.zeros((1, len(names)))
        self.encoders: list[np.ndarray] = []
        self.begin = 0.0

    def rest(self, encoder: Float[np.ndarray, "J"], seconds: float) -> None:
        """Put the robot where its encoders read `encoder` and let it settle at that command."""
        self.data.qpos[self.qpos] = (encoder - self.plant.offset) / self.plant.ratio
        mujoco.mj_forward(self.model, self.data)
        self.begin = seconds
        self.run(encoder, seconds)

    def run(self, command: Float[np.ndarray, "J"], until: float) -> None:
        """Hold a command until the clock of the simulation says `until` [s]."""
        steps = round((until - self.data.time) / self.step)
        held = np.repeat(command[None, None], max(steps, 0), axis=0)
        for setpoint in self._setpoints:
            held = setpoint.follow(held)
        for row in held:
            self._kick(row)
        mujoco.mj_fwdPosition(self.model, self.data)

    def encoder(self) -> Float[np.ndarray, "J"]:
        """What the recorder gets now."""
        history = np.array(self.encoders[-round(MEMORY / self.step) :])
        clock = self.step * np.arange(len(history))
        for term in self._recording:
            history = term.record(history, clock)
        return history[-1].copy()

    def _kick(self, command: Float[np.ndarray, "1 J"]) -> None:
        data, plant = self.data, self.plant
        q, v = data.qpos[self.qpos][None], data.qvel[self.dofs][None]
        error = command - (plant.ratio * q + plant.offset)
        now = Moment(data.time - self.begin + 0.5 * self.step, self.step, q, v, q, v, error, self.load)
        for term in self._error:
            now.error = term.error(now.error, now)
        torque = plant.kp * now.error - plant.kd * v
        for term in self._drive:
            torque = term.drive(torque, now)
        torque = np.clip(torque, -plant.limit, plant.limit)
        motor, link = torque, 0.0
        for term in self._passive:
            more = term.passive(now)
            if more is not None and term.link_side:
                link = link + more
            elif more is not None:
                motor = motor + more
        if self._sprung:
            link = link - plant.stiffness * (q - plant.rest)
        uneven = 0.0
        if self._dry:
            up = down = plant.frictionloss[None]
            for term in self._dry:
                up, down = term.dry(up, down, now)
            self.model.dof_frictionloss[self.dofs] = np.maximum(0.5 * (up + down)[0], 1e-9)
            uneven = 0.5 * (up - down)
        data.qfrc_applied[self.dofs] = (motor + link - uneven)[0]
        mujoco.mj_step(self.model, data)
        rubbing = np.zeros(q.shape[1])
        rows = slice(data.ne, data.ne + data.nf)
        rubbing[self._column[data.efc_id[rows]]] = data.efc_force[rows]
        braked = plant.damping * v + plant.armature * data.qacc[self.dofs]
        self.load = motor - uneven + rubbing - braked
        self.encoders.append(plant.ratio * data.qpos[self.qpos] + plant.offset)
        if len(self.encoders) > 20_000:
            del self.encoders[:10_000]


class _Setpoint:
    """A term that filters commands, fed piece by piece."""

    def __init__(self, term: Term, step: float) -> None:
        self.term, self.step, self.past = term, step, np.zeros((0, 1, 0))
        self.keeps = round(MEMORY / step) if isinstance(term, ActuatorDelay) else 1

    def follow(self, command: Float[np.ndarray, "S 1 J"]) -> Float[np.ndarray, "S 1 J"]:
        before = self.past if len(self.past) else command[:1]
        whole = np.concatenate([before, command])
        out = self.term.setpoint(whole, self.step)
        # a delay needs what went in, a filter or a slew limit what came out last
        self.past = (whole if isinstance(self.term, ActuatorDelay) else out)[-self.keeps :]
        return out[len(before) :]


def true_plant(truth: Truth, nominal: mujoco.MjModel, terms: Sequence[Term]) -> Plant:
    """The robot with its nuisance parameters and its hidden effects' numbers.

    Raises:
        EdreamError: an effect puts something between motor and link, or friction is smooth, which robots among things do not have.
    """
    plant = truth.plant(nominal)
    for term in terms:
        plant = term.plant(plant)
    if np.isfinite(plant.give).any():
        raise EdreamError(
            "Joint compliance and backlash cannot be hidden in a robot that does tasks; leave them out of record.effects."
        )
    if plant.smooth:
        raise EdreamError("Dry friction of a robot that does tasks holds; leave record.smooth at 0.")
    return plant


def hollow(spec: mujoco.MjSpec, truth: Truth, nominal: mujoco.MjModel, step: float) -> None:
    """Take from a robot's spec what reality does by its own equations: actuators, friction, springs; add what it truly carries."""
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for actuator in list(spec.actuators):
        spec.delete(actuator)
    for joint in spec.joints:
        joint.frictionloss, joint.stiffness = 1e-6, np.zeros(3)
        joint.solref_friction, joint.solimp_friction = [2.0 * step, 1.0], [0.9999, 0.9999, 0.001, 0.5, 2.0]
    for hidden, term in zip(truth.effects, truth.terms(nominal), strict=True):
        if isinstance(term, Payload):
            at = [hidden.values[axis] for axis in "xyz"]
            load = spec.body(hidden.targets[0]).add_body(name=f"payload_{hidden.targets[0]}", pos=at)
            load.mass, load.ipos, load.inertia, load.explicitinertial = hidden.values["mass"], np.zeros(3), [1e-7] * 3, True
