"""A robot with effects placed on it: compiled once, simulated many times."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import batch

from edream.core.effect import Effect, joint_index
from edream.core.errors import EdreamError
from edream.core.parameters import Parameter, ParameterSpace
from edream.sim.lean import lean_spec
from edream.sim.mass import hold_weights
from edream.sim.robot import RobotModel

T = TypeVar("T")
LINEAR = {
    "rad": "m",
    "rad/s": "m/s",
    "rad/(N m)": "m/N",
    "N m": "N",
    "N m/rad": "N/m",
    "N m/rad^3": "N/m^3",
    "N m s/rad": "N s/m",
    "N m s^2/rad^2": "N s^2/m^2",
    "N m/(rad s)": "N/(m s)",
    "kg m^2": "kg",
    "1/(N m)": "1/N",
}


def unit_at(parameter: Parameter, model: mujoco.MjModel, targets: Sequence[str]) -> str:
    """The unit of a parameter at its place: effects say theirs for joints that turn, and a joint that slides has the linear one."""
    slides = [
        index
        for target in targets
        for index in [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, target.partition("<-")[0])]
        if index >= 0 and model.jnt_type[index] == mujoco.mjtJoint.mjJNT_SLIDE
    ]
    return LINEAR.get(parameter.unit, parameter.unit) if slides and len(slides) == len(targets) else parameter.unit


@dataclass(frozen=True)
class Scaling:
    """A known condition of a recording that multiplies a parameter: value x condition / reference.

    Attributes:
        condition: its name.
        reference: its value where the parameter is as the model has it.
        otherwise: what it is in a recording that does not say; None where every recording has to.
    """

    condition: str
    reference: float
    otherwise: float | None = None

    def factor(self, conditions: Mapping[str, float]) -> float:
        """What multiplies the parameter in a recording with these conditions.

        Raises:
            EdreamError: the recording does not say, and has to.
        """
        value = conditions.get(self.condition, self.otherwise)
        if value is None:
            known = ", ".join(sorted(conditions)) or "none"
            raise EdreamError(
                f"A recording has no condition {self.condition!r}, which the robot's config uses to scale a parameter. "
                f"What it has: {known}. Add the column to conditions.csv."
            )
        return value / self.reference


SERVO_GAIN = "servo_gain.kp"
# every recording may say by what share of the usual one its servos' position gain was another
USUAL = {SERVO_GAIN: Scaling("servo_gain", 1.0, otherwise=1.0)}


@dataclass(frozen=True)
class Placement:
    """One effect at one place. Several targets share one set of numbers.

    Attributes:
        effect: the effect.
        targets: joint, body or geom names; for a pair, each target is "first<-second"; empty for the world.
        scaled: quantity -> the condition that multiplies it.
        fixed: quantity -> a value that is held, not searched.
        bounds: quantity -> fields of `Parameter` to replace (low, high, start, spread), from the config.
    """

    effect: Effect
    targets: tuple[str, ...] = ()
    scaled: Mapping[str, Scaling] | None = None
    fixed: Mapping[str, float] | None = None
    bounds: Mapping[str, Mapping[str, float]] | None = None

    @property
    def label(self) -> str:
        """The place as part of a parameter's name."""
        return "+".join(self.targets)

    def full_name(self, quantity: str) -> str:
        return f"{self.effect.name}.{quantity}[{self.label}]" if self.targets else f"{self.effect.name}.{quantity}"

    def parameters(self, model: mujoco.MjModel) -> tuple[Parameter, ...]:
        """This placement's parameters under their full names."""
        out = []
        for parameter in self.effect.parameters(model, self.targets):
            changes = dict((self.bounds or {}).get(parameter.name, {}))
            if parameter.name in (self.fixed or {}):
                continue
            unit = unit_at(parameter, model, self.targets)
            out.append(replace(parameter, **changes, name=self.full_name(parameter.name), unit=unit))
        return tuple(out)


@dataclass(frozen=True, eq=False)
class SimulatedRobot:
    """A robot and the effects placed on it.

    Attributes:
        robot: the published model.
        placements: the effects, written in this order.
        entire: whether it is the model with all that it has, solved as it says; see `swift`.
    """

    robot: RobotModel
    placements: tuple[Placement, ...]
    entire: bool = True

    @cached_property
    def space(self) -> ParameterSpace:
        """Every parameter that is searched, in the order of the placements."""
        return ParameterSpace(tuple(p for placement in self.placements for p in placement.parameters(self.robot.model)))

    @property
    def has_hooks(self) -> bool:
        return any(placement.effect.hook for placement in self.placements)

    def spec(self) -> mujoco.MjSpec:
        """The robot's spec with every effect's structure added; numbers are still to be written."""
        spec = (
            self.robot.spec()
            if self.entire
            else lean_spec(self.robot, {target for one in self.placements for target in one.targets})
        )
        for placement in self.placements:
            for target in placement.targets or ("",):
                placement.effect.edit(spec, target)
        return spec

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model with every effect's structure. Treat as read only.

        Raises:
            EdreamError: MuJoCo cannot compile it.
        """
        try:
            model = self.spec().compile()
        except ValueError as error:
            names = ", ".join(placement.effect.name for placement in self.placements)
            raise EdreamError(
                f"Robot {self.robot.name!r} with {names}: MuJoCo cannot compile it: {' '.join(str(error).split())}"
            ) from error
        if not self.entire:
            _hasten(model, self.robot.clear)
        return model

    @cached_property
    def swift(self) -> "SimulatedRobot":
        """The same robot for searches, which simulate it often.

        Where dry friction and joint limits are its only constraints, projected Gauss-Seidel solves them: one number a joint, so it
        converges in a few sweeps, in about half of Newton's time and closer than Newton's usual tolerance. What only shows is left
        away, and where nothing touches in the recordings, no contact is looked for.
        """
        return replace(self, entire=False)

    def with_placements(self, placements: Sequence[Placement]) -> "SimulatedRobot":
        return replace(self, placements=tuple(placements))

    @cached_property
    def _names(self) -> list[list[str]]:
        """Each placement's parameters; asked for once, since effects look at many poses to find their bounds."""
        return [[p.name for p in one.effect.parameters(self.robot.model, one.targets)] for one in self.placements]

    def quantities(
        self, values: Float[np.ndarray, "N P"], conditions: Sequence[Mapping[str, float]]
    ) -> list[dict[str, Float[np.ndarray, "N"]]]:
        """The numbers that each placement writes, with fixed values filled in and known conditions applied.

        Args:
            values: one row a simulation, in the order of `space`.
            conditions: each simulation's known conditions.

        Raises:
            EdreamError: a recording lacks a condition that scales a parameter.
        """
        columns = dict(zip(self.space.names, np.asarray(values, dtype=float).T, strict=True))
        out = []
        for placement, names in zip(self.placements, self._names, strict=True):
            numbers = {}
            for name in names:
                fixed = (placement.fixed or {}).get(name)
                column = np.full(len(values), fixed) if fixed is not None else columns[placement.full_name(name)]
                scaling = (placement.scaled or {}).get(name)
                if scaling is not None:
                    column = column * np.array([scaling.factor(one) for one in conditions])
                numbers[name] = column
            out.append(numbers)
        return out


def _hasten(model: mujoco.MjModel, clear: bool) -> None:
    """Make a model quicker to simulate where that changes nothing; `clear` says that its geoms never touch."""
    if clear:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    friction_alone = not (model.neq or model.ntendon or model.nflex) and (clear or not (model.npair or _may_touch(model)))
    if friction_alone and model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON:
        model.opt.solver = mujoco.mjtSolver.mjSOL_PGS
    if model.ntree == 1:  # one island, which need not be looked for
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND


def _may_touch(model: mujoco.MjModel) -> bool:
    """Whether MuJoCo would look for a contact between any two geoms: of bodies that move, and not of a parent and its child."""
    first, second = np.triu_indices(model.ngeom, 1)
    body = model.body_weldid[model.geom_bodyid]
    kind, affinity = model.geom_contype, model.geom_conaffinity
    parent = model.body_weldid[model.body_parentid[body]]
    related = (body[first] == body[second]) | ((parent[first] == body[second]) & (body[second] != 0))
    related |= (parent[second] == body[first]) & (body[first] != 0)
    return bool((((kind[first] & affinity[second]) | (kind[second] & affinity[first])) != 0)[~related].any())


class BatchFields:
    """The model fields of a `mujoco.batch.Batch`, given per-simulation values as they are asked for."""

    def __init__(self, simulations: batch.Batch, model: mujoco.MjModel) -> None:
        self.model = model
        self.count = simulations.nsim
        self.touched: set[str] = set()
        self.merged: set[str] = set()
        self._simulations = simulations

    def __getitem__(self, name: str) -> Float[np.ndarray, "N ..."]:
        self.touched.add(name)
        return self._simulations.expand(name)


def write_fields(
    simulated: SimulatedRobot,
    simulations: batch.Batch,
    numbers: Sequence[Mapping[str, Float[np.ndarray, "N"]]],
    weights: Float[np.ndarray, "N"] | None = None,
) -> BatchFields:
    """Write every placement's numbers into a batch, and what each hand holds [kg], and bring derived constants up to date."""
    fields = BatchFields(simulations, simulated.model)
    for placement, values in late_last(zip(simulated.placements, numbers, strict=True)):
        for target in placement.targets or ("",):
            placement.effect.write(fields, target, values)
    if weights is not None:
        hold_weights(fields, simulated.robot, weights)
    if fields.touched & DERIVING:
        simulations.set_const()
    return fields


def late_last(pairs: Iterable[tuple[Placement, T]]) -> list[tuple[Placement, T]]:
    """Placements in their order, but those whose effects change what others wrote at the end."""
    return sorted(pairs, key=lambda pair: pair[0].effect.late)


# mj_setConst also reads damping and armature, but only for invweight and diagnostics; kinematics and inertia need it.
DERIVING = {"body_mass", "body_ipos", "body_inertia", "body_iquat", "qpos0", "dof_armature", "body_pos", "body_quat"}


def hook_index(model: mujoco.MjModel, effect: Effect, target: str) -> dict[str, int]:
    """The addresses that an effect's hook is given for one target."""
    if effect.place == "pair":
        first, second = target.split("<-")
        return joint_index(model, first) | {f"other_{key}": value for key, value in joint_index(model, second).items()}
    return joint_index(model, target) if effect.place == "joint" else {}
