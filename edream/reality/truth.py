"""What is true of the make-believe robot, how it is drawn, and how it is kept from eyes that should not see it."""

import base64
import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from edream.core.errors import EdreamError, unknown_name
from edream.reality.effects import KINDS, Kind, Scale, kind
from edream.reality.plant import NUISANCE, Plant, Term, nominal_plant
from edream.sim.robot import RobotModel

SEAL = "edream sealed truth 1"
# what robots at work commonly have, and what spoils a grasp: losses under load, lateness, and a weight or pull nobody told of
COMMON = (
    ("load_friction", "directional_efficiency", "servo_gain"),
    ("actuator_delay", "actuator_lag"),
    ("payload", "constant_torque", "parallel_spring"),
)


@dataclass(frozen=True)
class Hidden:
    """One effect at work.

    Attributes:
        name: which effect.
        targets: the joint or body it acts on; for a coupling, the joint it acts on and the joint it comes from.
        values: its numbers, SI.
    """

    name: str
    targets: tuple[str, ...]
    values: Mapping[str, float]


@dataclass(frozen=True)
class Truth:
    """All that is true and that the nominal model does not say.

    Attributes:
        robot: name of the robot.
        effects: the hidden effects, in the order in which they act.
        nuisance: true kp, kd, damping, frictionloss and armature by joint; those not named are nominal.
        sees: whether encoder and servo sit on the link or the motor side of a shaft that gives.
        smooth: speed [rad/s] over which dry friction comes up, so that a stuck joint creeps; 0 where it holds.
        cell: what is true of its workcell: factors on the `mass` and `grip` (contact friction) of things, the seed of its `look`.
        cameras: what the cameras that recorded it are like, as `CellLook` has it; empty where none did.
    """

    robot: str
    effects: tuple[Hidden, ...] = ()
    nuisance: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    sees: Literal["link", "motor"] = "link"
    smooth: float = 0.0
    cell: Mapping[str, float] = field(default_factory=dict)
    cameras: Mapping[str, Any] = field(default_factory=dict)

    def plant(self, model: mujoco.MjModel) -> Plant:
        """The robot with its true nuisance parameters and none of its hidden effects."""
        plant = replace(nominal_plant(model), sees=self.sees, smooth=self.smooth)
        arrays = {}
        for quantity, by_joint in self.nuisance.items():
            if quantity not in NUISANCE:
                raise unknown_name("nuisance parameter", quantity, NUISANCE)
            arrays[quantity] = np.array([by_joint.get(j, v) for j, v in zip(plant.joints, getattr(plant, quantity), strict=True)])
        return plant.with_values(**arrays)

    def at_gain(self, model: mujoco.MjModel, share: float) -> "Truth":
        """The same robot with every servo's position gain set to a share of what it truly is."""
        if share == 1.0:
            return self
        plant = self.plant(model)
        gains = {joint: share * float(gain) for joint, gain in zip(plant.joints, plant.kp, strict=True)}
        return replace(self, nuisance={**self.nuisance, "kp": gains})

    def holding(self, body: str, point: np.ndarray, weight: float) -> "Truth":
        """The same robot with a weight [kg] in its hand, at a point [m] in the frame of the body at its end."""
        if not weight:
            return self
        x, y, z = map(float, point)
        return replace(self, effects=(*self.effects, Hidden("payload", (body,), {"mass": weight, "x": x, "y": y, "z": z})))

    def terms(self, model: mujoco.MjModel) -> tuple[Term, ...]:
        """The hidden effects, ready for one run.

        Raises:
            EdreamError: an effect or a target does not exist.
        """
        joints = [model.joint(i).name for i in range(model.njnt)]
        bodies = [model.body(i).name for i in range(model.nbody)]
        terms = []
        for hidden in self.effects:
            sort = kind(hidden.name)
            if hidden.values.keys() != sort.absent.keys():
                raise EdreamError(
                    f"Hidden effect {hidden.name!r} needs the values {sorted(sort.absent)}, not {sorted(hidden.values)}."
                )
            acts_on = {"base": (), "body": (), "pair": hidden.targets[:1]}.get(sort.where, hidden.targets)
            on = np.array([float(j in acts_on) for j in joints])
            for target in hidden.targets:
                if target not in (bodies if sort.where == "body" else joints):
                    raise unknown_name(
                        "body" if sort.where == "body" else "joint", target, bodies if sort.where == "body" else joints
                    )
            other = -1
            if sort.where == "body":
                other = bodies.index(hidden.targets[0])
            elif sort.where == "pair":
                other = joints.index(hidden.targets[1])
            terms.append(sort.term(dict(hidden.values), on, other))
        return tuple(terms)


def draw(
    robot: RobotModel, names: Sequence[str], rng: np.random.Generator, deviation: float = 0.3, at: Sequence[str] = ()
) -> Truth:
    """A plausible truth in which the named effects are visible.

    Args:
        robot: the nominal robot.
        names: effects to hide; see `KINDS`.
        rng: where chance comes from.
        deviation: nuisance parameters are off by up to this share, log-uniform.
        at: target of each effect, in order; drawn where it is shorter than `names` or empty.
    """
    model = robot.model
    plant = nominal_plant(model)
    factor = {name: np.exp(rng.uniform(-1, 1, model.nv) * np.log1p(deviation)) for name in NUISANCE}
    gravity = _gravity_scale(plant, model)
    effects = []
    for index, name in enumerate(names):
        sort = kind(name)
        targets = _targets(sort, robot, plant, gravity, rng, at[index] if index < len(at) else "")
        joint = plant.joints.index(targets[0]) if targets and sort.where != "body" else int(np.argmax(gravity))
        values = sort.draw(rng, _scale(plant, model, gravity, joint))
        effects.append(Hidden(name, targets, {k: float(v) for k, v in values.items()}))
        for changed in sort.changes:
            factor[changed][joint] = 1.0
    nuisance = {
        name: {j: float(v) for j, v in zip(plant.joints, getattr(plant, name) * factor[name], strict=True)} for name in NUISANCE
    }
    return Truth(robot.name, tuple(effects), nuisance)


def drawn_effects(seed: int) -> tuple[str, ...]:
    """Effects to hide where the user names none: one of each group of `COMMON`, by chance."""
    rng = np.random.default_rng(np.random.SeedSequence((seed, 0xD1)))
    return tuple(str(rng.choice(group)) for group in COMMON)


def with_cell(truth: Truth, seed: int) -> Truth:
    """The same robot at a workbench: things are heavier or lighter than they look, and more slippery than one would think."""
    rng = np.random.default_rng(np.random.SeedSequence((seed, 0xCE11)))
    cell = {"mass": float(rng.uniform(0.8, 1.4)), "grip": float(rng.uniform(0.7, 0.95)), "look": float(rng.integers(2**31))}
    return replace(truth, cell=cell)


def absent(truth: Truth) -> Truth:
    """The same truth with every effect at the values at which it is not there."""
    effects = tuple(Hidden(h.name, h.targets, dict(KINDS[h.name].absent)) for h in truth.effects)
    return replace(truth, effects=effects)


def seal(truth: Truth, path: Path) -> str:
    """Write a truth so that nobody reads it by accident; returns its digest.

    Raises:
        EdreamError: the file exists.
    """
    if path.exists():
        raise EdreamError(f"There is already a truth at {path}; it was left as it is.")
    plain = json.dumps(asdict(truth), sort_keys=True).encode()
    digest = hashlib.sha256(plain).hexdigest()
    packed = base64.b64encode(zlib.compress(plain, 9)).decode()
    path.write_text(json.dumps({"seal": SEAL, "digest": digest, "content": packed}, indent=1) + "\n", encoding="utf-8")
    return digest


def unseal(path: Path) -> Truth:
    """Open a sealed truth, for scoring.

    Raises:
        EdreamError: it is not one, or it was altered.
    """
    try:
        sealed = json.loads(path.read_text(encoding="utf-8"))
        plain = zlib.decompress(base64.b64decode(sealed["content"]))
        intact = sealed["seal"] == SEAL and hashlib.sha256(plain).hexdigest() == sealed["digest"]
    except (OSError, ValueError, KeyError, TypeError, zlib.error) as error:
        raise EdreamError(
            f"{path} is not a sealed truth: {type(error).__name__}. Expected a file that 'edream record' wrote."
        ) from error
    if not intact:
        raise EdreamError(f"The sealed truth {path} was altered: its digest does not match its content.")
    fields: dict[str, Any] = json.loads(plain)
    if unknown := sorted(fields.keys() - Truth.__dataclass_fields__.keys()):
        raise EdreamError(
            f"The sealed truth {path} holds {', '.join(unknown)}, which this edream does not know: a newer one wrote it."
        )
    hidden = tuple(Hidden(h["name"], tuple(h["targets"]), h["values"]) for h in fields["effects"])
    fields["effects"] = hidden
    return Truth(**fields)


def _gravity_scale(plant: Plant, model: mujoco.MjModel) -> np.ndarray:
    """Root mean square of each joint's gravity torque over its range."""
    rng = np.random.default_rng(0)
    low, high = joint_range(model)
    q = rng.uniform(low, high, (64, model.nv))
    _, bias = plant.tree.terms(q, np.zeros_like(q), plant.gravity)
    return np.sqrt(np.mean(np.square(bias), axis=0))


def joint_range(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest position of each joint; a turn either way where it is not limited."""
    limited = np.asarray(model.jnt_limited, dtype=bool)
    return np.where(limited, model.jnt_range[:, 0], -np.pi), np.where(limited, model.jnt_range[:, 1], np.pi)


def _scale(plant: Plant, model: mujoco.MjModel, gravity: np.ndarray, joint: int) -> Scale:
    low, high = joint_range(model)
    span = (high[joint] - low[joint]) / 3.0
    small = min(span, 1.0)
    mass, _ = plant.tree.terms(((low + high) / 2.0)[None], np.zeros((1, model.nv)), plant.gravity)
    carried = float(plant.tree.below[joint] @ plant.tree.inertia[:, 3, 3])
    shift = 0.008 * small * plant.kp[joint]
    least = 2.0 * plant.frictionloss[joint]
    return Scale(
        torque=float(min(max(shift, least), 0.25 * plant.limit[joint])),
        gravity=float(gravity[joint]),
        inertia=float(mass[0, joint, joint] + plant.armature[joint]),
        kp=float(plant.kp[joint]),
        damping=float(plant.kd[joint] + plant.damping[joint]),
        limit=float(plant.limit[joint]),
        speed=float(1.2 * small),
        span=float(span),
        middle=float(low[joint] + high[joint]) / 2.0,
        lever=float(max(gravity[joint] / (9.81 * carried), 0.02)),
    )


def _targets(
    sort: Kind, robot: RobotModel, plant: Plant, gravity: np.ndarray, rng: np.random.Generator, wish: str
) -> tuple[str, ...]:
    hinges = np.flatnonzero(~plant.tree.is_slide)
    if sort.where == "base":
        return ()
    if sort.where == "body":
        model = robot.model
        last = int(model.site(robot.site).bodyid[0]) if robot.site else int(model.jnt_bodyid[hinges[-1]])
        return (wish or model.body(last).name,)
    choices = hinges[gravity[hinges] >= 0.2 * gravity[hinges].max()] if sort.where == "loaded" else hinges
    joint = plant.joints.index(wish) if wish in plant.joints else int(rng.choice(choices))
    if wish and wish not in plant.joints:
        raise unknown_name("joint", wish, plant.joints)
    if sort.where == "pair":
        others = [int(i) for i in hinges if i != joint]
        nearest = sorted(others, key=lambda i: (abs(i - joint), i))[:2]
        return (plant.joints[joint], plant.joints[int(rng.choice(nearest))])
    return (plant.joints[joint],)
