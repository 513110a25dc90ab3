"""A robot with its effects and values, written as plain MJCF and, for what MJCF cannot say, a hook file."""

import difflib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from posixpath import isabs, normpath
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float
from mujoco import batch

from edream.core.errors import EdreamError
from edream.sim.hook_file import hook_text
from edream.sim.robot import RobotModel
from edream.sim.simulation import SimulatedRobot, write_fields

NUMBER = re.compile(r"(?<![\w.#])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
# model field -> kind of element, its attribute in a spec, and which component where several fields share one
FIELDS = {
    "dof_damping": ("joint", "damping", 0),
    "dof_dampingpoly": ("joint", "damping", slice(1, 3)),
    "dof_frictionloss": ("joint", "frictionloss", None),
    "dof_solref": ("joint", "solref_friction", slice(None)),
    "dof_solimp": ("joint", "solimp_friction", slice(None)),
    "dof_armature": ("joint", "armature", None),
    "jnt_stiffness": ("joint", "stiffness", 0),
    "jnt_stiffnesspoly": ("joint", "stiffness", slice(1, 3)),
    "jnt_range": ("joint", "range", slice(None)),
    "qpos0": ("joint", "ref", None),
    "qpos_spring": ("joint", "springref", None),
    "actuator_gainprm": ("actuator", "gainprm", slice(None)),
    "actuator_biasprm": ("actuator", "biasprm", slice(None)),
    "actuator_dynprm": ("actuator", "dynprm", slice(None)),
    "actuator_gear": ("actuator", "gear", slice(None)),
    "actuator_forcerange": ("actuator", "forcerange", slice(None)),
    "actuator_delay": ("actuator", "delay", None),
    "tendon_stiffness": ("tendon", "stiffness", 0),
    "tendon_damping": ("tendon", "damping", 0),
    "tendon_range": ("tendon", "range", slice(None)),
    "tendon_lengthspring": ("tendon", "springlength", slice(None)),
    "eq_active0": ("equality", "active", None),
    "body_mass": ("body", "mass", None),
    "body_ipos": ("body", "ipos", slice(None)),
    "body_inertia": ("body", "inertia", slice(None)),
    "body_iquat": ("body", "iquat", slice(None)),
    "geom_friction": ("geom", "friction", slice(None)),
    "sensor_delay": ("sensor", "delay", None),
}
DERIVED = {"body_subtreemass", "body_invweight0", "dof_invweight0", "dof_M0", "actuator_acc0", "tendon_invweight0"}


@dataclass(frozen=True)
class EmittedModel:
    """A robot model that any MuJoCo program can load.

    Attributes:
        mjcf: the MJCF; meshes and textures keep their file names.
        files: those meshes and textures, path beside the MJCF -> bytes.
        hook: a Python file with `make(model)` returning `step(model, data)`, or None where the MJCF says it all.
        difference: unified difference of the MJCF against the published robot, both written by MuJoCo.
    """

    mjcf: str
    files: Mapping[str, bytes]
    hook: str | None
    difference: str


def emit(
    simulated: SimulatedRobot,
    values: Mapping[str, float] | Float[np.ndarray, "P"],
    conditions: Mapping[str, float] | None = None,
    beside: RobotModel | None = None,
) -> EmittedModel:
    """Write a robot with effects as plain MJCF, every number with all its digits.

    Args:
        simulated: the robot and its effects.
        values: full parameter name -> value for every parameter of `simulated.space`, or the values in its order.
        conditions: known conditions to write it for; each at its reference where None.
        beside: the robot that the difference is against; that of `simulated` where None.

    Raises:
        EdreamError: a value is missing, or a field that an effect writes has no place in an MJCF.
    """
    if not isinstance(values, Mapping):
        values = simulated.space.mapping(values)
    missing = [name for name in simulated.space.names if name not in values]
    if missing:
        raise EdreamError(f"No value for {', '.join(missing[:5])}; expected one for each of the {len(simulated.space)} parameters.")
    known = dict(conditions or _references(simulated))
    numbers = simulated.quantities(simulated.space.vector(values)[None], [known])
    simulations = batch.Batch(simulated.model, 1, 1)
    touched = write_fields(simulated, simulations, numbers).touched
    target = simulations.get_model(0)
    spec = simulated.spec()
    compiled = spec.compile()
    for name in sorted(touched):
        _transfer(spec, compiled, target, name)
    final = spec.compile()
    mjcf = _all_digits(spec.to_xml(), simulated.robot.mjcf, final)
    published = (beside or simulated.robot).published
    original = _all_digits(_compiled_xml(published.spec()), published.mjcf, published.model)
    lines = difflib.unified_diff(original.splitlines(), mjcf.splitlines(), "published", "with effects", lineterm="", n=2)
    return EmittedModel(mjcf, _beside(simulated.robot.assets), hook_text(simulated, numbers, final), "\n".join(lines) + "\n")


def _beside(assets: Mapping[str, bytes]) -> dict[str, bytes]:
    """Assets by where they lie beside the MJCF; one that the model names by an absolute path is found there as it is."""
    return {normpath(name): data for name, data in assets.items() if not isabs(name)}


def _references(simulated: SimulatedRobot) -> dict[str, float]:
    return {one.condition: one.reference for placement in simulated.placements for one in (placement.scaled or {}).values()}


def _compiled_xml(spec: mujoco.MjSpec) -> str:
    spec.compile()
    return spec.to_xml()


def _transfer(spec: mujoco.MjSpec, before: mujoco.MjModel, after: mujoco.MjModel, name: str) -> None:
    """Set in a spec what differs between two models in one field."""
    if name.startswith("opt."):
        setattr(spec.option, name.removeprefix("opt."), getattr(after.opt, name.removeprefix("opt.")))
        return
    old, new = getattr(before, name), getattr(after, name)
    rows = np.flatnonzero((old != new).reshape(len(old), -1).any(axis=1))
    if not len(rows):
        return
    if name not in FIELDS:
        raise EdreamError(f"Model field {name!r} was changed, but MJCF has no place for it that edream knows.")
    kind, attribute, part = FIELDS[name]
    for row in rows:
        element = _element(spec, before, name, kind, int(row))
        value = np.array(new[row]) if np.ndim(new[row]) else new[row].item()
        if part is None:
            setattr(element, attribute, bool(value) if attribute == "active" else value)
        else:
            whole = np.array(getattr(element, attribute), dtype=float)
            if isinstance(part, slice) and part == slice(None):
                whole[: np.size(value)] = value
            else:
                whole[part] = value
            setattr(element, attribute, whole)
        if kind == "body":
            element.explicitinertial, element.fullinertia = True, np.array([np.nan, 0, 0, 0, 0, 0])


def _element(spec: mujoco.MjSpec, model: mujoco.MjModel, field: str, kind: str, row: int) -> Any:
    """The spec's element of a row of a model field. Elements keep their order from spec to model."""
    if field.startswith("dof_"):
        row = int(model.dof_jntid[row])
    elif field.startswith("qpos"):
        row = int(np.searchsorted(model.jnt_qposadr, row, side="right") - 1)
    every = {
        "joint": spec.joints,
        "actuator": spec.actuators,
        "tendon": spec.tendons,
        "equality": spec.equalities,
        "body": spec.bodies,
    }
    elements = every | {"geom": spec.geoms, "sensor": spec.sensors}
    name = getattr(model, {"equality": "eq"}.get(kind, kind))(row).name
    return next((one for one in elements[kind] if name and one.name == name), elements[kind][row])


def _all_digits(written: str, source: str, model: mujoco.MjModel) -> str:
    """MJCF as MuJoCo writes it, whose numbers have six digits, with every digit that the model or its source has.

    A number is replaced by the one that rounds to it. Two numbers of one model that agree in six digits are told apart by nothing;
    then the number stays as written, if it is one of them, or becomes the first.
    """
    exact: dict[str, list[float]] = {}
    for value in _numbers(source, model):
        choices = exact.setdefault(f"{value:g}", [])
        if value not in choices:
            choices.append(value)

    def digits(match: re.Match[str]) -> str:
        number = float(match[0])
        choices = exact.get(f"{number:g}", [])
        return match[0] if not choices or number in choices else repr(choices[0])

    def attribute(match: re.Match[str]) -> str:
        return match[1] + NUMBER.sub(digits, match[2]) + match[3]

    return re.sub(r'(\b(?!name|class|joint|body|mesh|file|material|site|geom|tendon)\w+=")([^"]*)(")', attribute, written)


def _numbers(source: str, model: mujoco.MjModel) -> Iterator[float]:
    for name in sorted(dir(model)):
        field = getattr(model, name, None) if not name.startswith("_") and name not in DERIVED else None
        if isinstance(field, np.ndarray) and field.dtype == np.float64 and field.size < 100_000 and "mesh" not in name:
            yield from np.ravel(field).tolist()
    yield from (float(model.opt.timestep), *map(float, model.opt.gravity))
    yield from (float(one) for one in NUMBER.findall(source))
