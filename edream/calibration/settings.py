"""Which effects act where, from the config: the robot whose parameters are searched."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from edream import catalog
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.core.errors import EdreamError, require, unknown_name
from edream.core.parameters import ParameterSpace
from edream.sim.mjcf_field import MjcfField
from edream.sim.robot import RobotModel, joint_groups, load_robot
from edream.sim.simulation import USUAL, Placement, Scaling, SimulatedRobot

WEAK_PRIOR = 0.5  # of the unit box; decides only what the data leave open


@dataclass(frozen=True)
class RobotSettings:
    """The robot to calibrate.

    Attributes:
        mjcf: its model.
        name: what reports call it; the file's stem where None.
        site: end-effector site; the last body where None.
        joints: the recorded joints, where the model drives more; empty for all.
    """

    mjcf: Path
    name: str | None = None
    site: str | None = None
    joints: tuple[str, ...] = ()

    def load(self) -> RobotModel:
        """The robot's model.

        Raises:
            EdreamError: it cannot be read.
        """
        return load_robot(self.mjcf, self.name, self.site, self.joints)

    def content(self) -> bytes:
        """All that the model says, its includes and assets too, as bytes for a key."""
        robot = self.load()
        return b"\0".join([robot.mjcf.encode(), *(name.encode() + b"\0" + data for name, data in sorted(robot.assets.items()))])


@dataclass(frozen=True)
class ScaledBy:
    """A known condition that multiplies a parameter: value x condition / reference."""

    condition: str
    reference: float

    def __post_init__(self) -> None:
        require(self.reference > 0.0, f"The reference of condition {self.condition!r}", self.reference, "a number above 0")


@dataclass(frozen=True)
class Limits:
    """What the config says about a parameter in place of the effect's own words.

    Attributes:
        low, high: the box it is searched in.
        start: where the search begins; with a spread, the prior's centre.
        spread: standard deviation of the prior.
    """

    low: float | None = None
    high: float | None = None
    start: float | None = None
    spread: float | None = None

    def __post_init__(self) -> None:
        require(self.spread is None or self.spread > 0.0, "A spread in fit.limits", self.spread, "a number above 0")


@dataclass(frozen=True)
class SpaceSettings:
    """What is unknown, and which motions may teach it.

    Attributes:
        effects: what acts: an effect (`coulomb`) on every joint that counts, tied by `ties`; an effect at a place
            (`coulomb@elbow_flex`, several that share their numbers `coulomb@wrist_flex+wrist_roll`); or a model field
            (`body.mass@gripper`).
        ties: groups of joints that share their numbers; joints in no group stand alone. [[all]] ties every joint.
        fixed: parameter -> value that is held.
        limits: parameter -> bounds and prior. A name without its place, such as `coulomb.torque`, means every place.
        scaled: quantity, such as `servo_gain.kp` -> the condition that multiplies it.
        joints: joints that count in the loss; empty for all but those that grip.
        grips: joints that hold things, such as a gripper: fitted by themselves, where they hold nothing, and never counted.
        holdout: names (or parts before a `*`) of motions that are never tuned on; empty to draw them.
        holdout_fraction: share of the motions that is drawn where `holdout` is empty.
        until: seconds of each motion that count, or None for all.
    """

    effects: tuple[str, ...]
    ties: tuple[tuple[str, ...], ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    limits: Mapping[str, Limits] = field(default_factory=dict)
    scaled: Mapping[str, ScaledBy] = field(default_factory=dict)
    joints: tuple[str, ...] = ()
    grips: tuple[str, ...] = ()
    holdout: tuple[str, ...] = ()
    holdout_fraction: float = 0.2
    until: float | None = None

    def __post_init__(self) -> None:
        require(self.until is None or self.until > 0.0, "fit.until", self.until, "seconds above 0, or null for whole motions")


def simulated_robot(robot: RobotModel, settings: SpaceSettings, recordings: Sequence[Episode] = ()) -> SimulatedRobot:
    """The robot with every effect of the config placed on it.

    Args:
        recordings: what it will be compared with, whose conditions may scale a number that the config says nothing about.

    Raises:
        EdreamError: an effect, joint, field or parameter does not exist, bounds contradict each other, or what the recordings'
            conditions scale is not among the effects.
    """
    known_scalings = scalings(settings.scaled, recordings)
    counted = counting(robot, settings.joints, settings.grips)
    bare = [p for text in settings.effects for p in _placements(robot, text, settings.ties, counted)]
    placements, met = [], set()
    for placement in bare:
        scaled, fixed, bounds = {}, {}, {}
        for parameter in placement.effect.parameters(robot.model, placement.targets):
            quantity, full = f"{placement.effect.name}.{parameter.name}", placement.full_name(parameter.name)
            met |= {quantity, full}
            for name in (quantity, full):
                if name in known_scalings:
                    scaled[parameter.name] = known_scalings[name]
                if name in settings.fixed:
                    fixed[parameter.name] = settings.fixed[name]
                if name in settings.limits:
                    bounds[parameter.name] = {k: v for k, v in vars(settings.limits[name]).items() if v is not None}
            _fit_start(parameter, bounds)
        placements.append(replace(placement, scaled=scaled, fixed=fixed, bounds=bounds))
    placed = {placement.effect.name for placement in placements}
    # what a robot's config says of an effect that is not searched this time is no mistake
    known = set(catalog.names("effects")) - placed
    about = [name for name in (*settings.scaled, *settings.limits) if name.partition(".")[0] not in known]
    for name in (*settings.fixed, *about):
        if name not in met:
            raise unknown_name("parameter", name, met)
    for name in set(known_scalings) - set(settings.scaled) - met:
        raise EdreamError(
            f"A recording notes {known_scalings[name].condition} in conditions.csv, which scales {name}, but fit.effects has no "
            f"{name.partition('.')[0]} of a position servo. Add it (fit.fixed can hold its value), or remove the column."
        )
    return SimulatedRobot(robot, tuple(with_weak_priors(robot, p) for p in placements))


def scalings(scaled: Mapping[str, ScaledBy], recordings: Sequence[Episode] | None = None) -> dict[str, Scaling]:
    """What conditions of a recording multiply: what the config says, and the servos' gain.

    With `recordings`, the gain only where one of them notes it.
    """
    usual = {n: s for n, s in USUAL.items() if recordings is None or any(s.condition in one.conditions for one in recordings)}
    return {**usual, **{name: Scaling(one.condition, one.reference) for name, one in scaled.items()}}


def with_weak_priors(robot: RobotModel, placement: Placement) -> Placement:
    """Give every parameter that has no prior one as wide as half its box, so that what the data leave open has an answer."""
    bounds = {name: dict(changes) for name, changes in (placement.bounds or {}).items()}
    for bare in placement.effect.parameters(robot.model, placement.targets):
        if bare.name in (placement.fixed or {}):
            continue
        changed = replace(bare, **bounds.get(bare.name, {}))
        if not np.isfinite(changed.spread):
            width = np.log(changed.high / changed.low) if changed.scale == "log" else changed.high - changed.low
            bounds.setdefault(bare.name, {})["spread"] = WEAK_PRIOR * float(width)
    return replace(placement, bounds=bounds)


def scored(robot: RobotModel, settings: SpaceSettings) -> np.ndarray:
    """Which joints count in the loss, (J,) bool.

    Raises:
        EdreamError: the robot has no such joint.
    """
    chosen = [robot.joint_index(name) for name in counting(robot, settings.joints, settings.grips)]
    return np.ones(len(robot.joints), bool) if not chosen else np.isin(np.arange(len(robot.joints)), chosen)


def counting(robot: RobotModel, joints: Sequence[str], grips: Sequence[str]) -> tuple[str, ...]:
    """Joints that count, empty for all: those named, or all but those that grip.

    Raises:
        EdreamError: one that grips is named to count, all grip, or the robot has no such joint.
    """
    for name in grips:
        robot.joint_index(name)
        if name in joints:
            raise EdreamError(f"{name} is in robot.grips and in robot.scored; what a gripper holds must not count: leave one out.")
    others = tuple(name for name in robot.joints if name not in grips)
    if not others:
        raise EdreamError("robot.grips names every joint, so that none is left to calibrate; name those that hold things alone.")
    return tuple(joints) or (others if grips else ())


def _fit_start(parameter, bounds) -> None:
    """Bounds that leave the effect's own start outside move the start to the nearest end."""
    changes = bounds.get(parameter.name)
    if changes and "start" not in changes:
        low, high = changes.get("low", parameter.low), changes.get("high", parameter.high)
        if low < high:
            changes["start"] = float(np.clip(parameter.start, low, high))


def _placements(robot: RobotModel, text: str, ties: Sequence[Sequence[str]], counted: Sequence[str]) -> list[Placement]:
    name, at, place = text.partition("@")
    targets = tuple(place.split("+")) if at else ()
    if "." in name:
        return [Placement(MjcfField.of(robot, name, targets), targets)]
    effect = catalog.load("effects", name, Effect)
    if effect.place == "joint":
        for joint in targets:
            robot.joint_index(joint)
        groups = [targets] if targets else joint_groups(robot, ties, counted)
        return [Placement(effect, group) for group in groups]
    if effect.place == "world":
        if targets:
            raise EdreamError(f"Effect {name!r} acts on the whole world; it has no place {place!r}.")
        return [Placement(effect)]
    if not targets:
        example = "elbow<-shoulder" if effect.place == "pair" else f"{effect.place}_name"
        raise EdreamError(f"Effect {name!r} acts on a {effect.place}; say which: {name}@{example}.")
    _check_targets(robot, effect, targets)
    return [Placement(effect, targets)]


def _check_targets(robot: RobotModel, effect: Effect, targets: Sequence[str]) -> None:
    if effect.place == "pair":
        for target in targets:
            first, arrow, second = target.partition("<-")
            if not arrow:
                raise EdreamError(
                    f"Effect {effect.name!r} acts on a joint because of another; expected 'first<-second', not {target!r}."
                )
            robot.joint_index(first)
            robot.joint_index(second)
        return
    model = robot.model
    known = (
        [model.body(i).name for i in range(model.nbody)]
        if effect.place == "body"
        else [model.geom(i).name for i in range(model.ngeom)]
    )
    for target in targets:
        if target not in known:
            raise unknown_name(effect.place, target, [one for one in known if one])


def space_of(simulated: SimulatedRobot) -> ParameterSpace:
    """The parameters that are searched.

    Raises:
        EdreamError: there is none.
    """
    if not len(simulated.space):
        raise EdreamError("Nothing is left to fit: fit.effects is empty, or fit.fixed holds every parameter.")
    return simulated.space
