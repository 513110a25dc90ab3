"""Every effect at every place it can act."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from edream.catalog import load, names
from edream.core.effect import Effect, holds_position, joint_index
from edream.core.errors import EdreamError
from edream.diagnosis.problem import Problem, scaling_of
from edream.sim.simulation import Placement, SimulatedRobot


@dataclass(frozen=True)
class Candidate:
    """An effect that may be missing, at one place.

    Attributes:
        effect: name in the library.
        targets: where it acts; several share their numbers.
    """

    effect: str
    targets: tuple[str, ...]

    @property
    def label(self) -> str:
        return f"{self.effect}[{'+'.join(self.targets)}]" if self.targets else self.effect


def placement(problem: Problem, candidate: Candidate) -> Placement:
    """The candidate as something that can be simulated, in the form that it has beside the problem's dry friction."""
    effect = load("effects", candidate.effect, Effect)
    effect = effect.creeping if problem.creep is not None and effect.creeping is not None else effect
    return Placement(effect, candidate.targets, scaled=scaling_of(problem, candidate.effect))


def standing(problem: Problem, candidate: Candidate, simulated: SimulatedRobot) -> Placement:
    """The candidate as it stands in a model, in its finer form there perhaps; as the library has it where it does not stand."""
    there = [p for p in simulated.placements if (p.effect.name, tuple(p.targets)) == (candidate.effect, candidate.targets)]
    return there[0] if there else placement(problem, candidate)


def probes_of(problem: Problem, place: Placement) -> list[dict[str, float]]:
    """Small versions of an effect for the score test, inside the box of what is searched; of a local one where the motions went."""
    boxes = {p.name: (p.low, p.high) for p in place.effect.parameters(problem.robot.model, place.targets)}
    probes = place.effect.probes(problem.narrowed if place.effect.local else problem.robot.model, place.targets)
    return [{name: float(np.clip(value, *boxes[name])) for name, value in probe.items()} for probe in probes]


def library(problem: Problem) -> list[Effect]:
    """The effects that may be named: the whole library or those asked for, less the nuisance and the ignored.

    Raises:
        EdreamError: nothing is left.
    """
    settings = problem.settings
    chosen = settings.effects or names("effects")
    left = [name for name in chosen if name not in settings.nuisance and name not in settings.ignored]
    if not left:
        raise EdreamError("No effect is left to look for: diagnose.effects names only nuisance or ignored ones.")
    return [load("effects", name, Effect) for name in left]


def rounds(problem: Problem, effects: Sequence[Effect]) -> list[list[Candidate]]:
    """Candidates in rounds: those of one round act on different joints and are probed in one simulation.

    Joint effects make one round each, over all joints that they can act on; a pair effect one for each second joint; bodies, geoms,
    the world one each. Those that shift links make one a joint, and one over all where joints may share their numbers.
    """
    model = problem.robot.model
    out: list[list[Candidate]] = []
    for effect in effects:
        if effect.place == "joint":
            there = [Candidate(effect.name, (joint,)) for joint in problem.joints if can_act(problem, effect, joint)]
            by_itself = effect.shifts_links and len(there) > 1
            out += [[one] for one in there] if by_itself else []
            out += [there] if effect.of_type or not by_itself else []
        elif effect.place == "pair":
            for second in problem.joints:
                out.append([Candidate(effect.name, (f"{first}<-{second}",)) for first in problem.joints if first != second])
        elif effect.place == "body":
            out += [[Candidate(effect.name, (body,))] for body in moving_bodies(problem)]
        elif effect.place == "geom":
            out += [[Candidate(effect.name, (geom,))] for geom in loose_geoms(model)]
        else:
            out.append([Candidate(effect.name, ())])
    return [one for one in out if one]


def can_act(problem: Problem, effect: Effect, joint: str) -> bool:
    """Whether an effect has a meaning on a joint, as it is driven."""
    return not effect.of_position_servo or holds_position(problem.robot.model, joint)


def acted_on(candidate: Candidate) -> frozenset[str]:
    """The joints that a candidate acts on, the first of a pair; none for links, objects and the world, whatever they are called."""
    if load("effects", candidate.effect, Effect).place not in ("joint", "pair"):
        return frozenset()
    return frozenset(target.split("<-")[0] for target in candidate.targets)


def untouched(problem: Problem, named: Sequence[Candidate]) -> frozenset[str]:
    """The joints on which nothing of what is named acts; none where some of it acts on no joint alone."""
    joints = [acted_on(candidate) for candidate in named]
    return frozenset(problem.joints).difference(*joints) if all(joints) else frozenset()


def moving_bodies(problem: Problem) -> list[str]:
    """The link that each recorded joint moves, by name."""
    model = problem.robot.model
    bodies = [model.body(int(model.jnt_bodyid[model.joint(joint).id])).name for joint in problem.joints]
    return [body for body in dict.fromkeys(bodies) if body]


def carried_by(problem: Problem, candidate: Candidate) -> frozenset[str]:
    """The joints that carry the links that a candidate acts on; none where it acts on no links."""
    if load("effects", candidate.effect, Effect).place != "body":
        return frozenset()
    model = problem.robot.model
    above = {int(model.body(body).id) for body in candidate.targets}
    while (further := above | {int(model.body_parentid[body]) for body in above}) != above:
        above = further
    return frozenset(joint for joint in problem.joints if int(model.jnt_bodyid[model.joint(joint).id]) in above)


def next_to(problem: Problem, candidate: Candidate) -> list[Candidate]:
    """A candidate on the links before and behind those that it acts on; nothing where it acts on no links."""
    if load("effects", candidate.effect, Effect).place != "body":
        return []
    model = problem.robot.model
    links = {int(model.body(link).id): link for link in moving_bodies(problem)}
    own = {int(model.body(target).id) for target in candidate.targets}

    def before(body: int) -> int:
        """The link that carries another one, across what is fixed between them; 0, the world, where none does."""
        above = int(model.body_parentid[body])
        return above if above in links or above == 0 else before(above)

    near = {before(body) for body in own} | {body for body in links if before(body) in own}
    return [Candidate(candidate.effect, (links[body],)) for body in sorted(near & links.keys() - own)]


def loose_geoms(model: mujoco.MjModel) -> list[str]:
    """Named geoms of free bodies that can collide: objects that the robot may touch."""
    free = {int(model.jnt_bodyid[j]) for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE}
    solid = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    return [model.geom(g).name for g in solid if int(model.geom_bodyid[g]) in free and model.geom(g).name]


def groups_of(problem: Problem, candidates: Sequence[Candidate]) -> list[Candidate]:
    """One effect on several single joints, as one candidate over each set of them that shares hardware, or may."""
    out = []
    for effect in dict.fromkeys(c.effect for c in candidates):
        entry = load("effects", effect, Effect)
        if entry.place != "joint" or not entry.of_type:
            continue
        places = {target for c in candidates if c.effect == effect for target in c.targets}
        known = [group for group in problem.groups if len(group) > 1 and len(places & set(group)) >= 2]
        out += [Candidate(effect, group) for group in (*known, *(g for g in alike(problem) if set(g) <= places))]
    return out


def confused_with(problem: Problem, effect: str) -> list[Effect]:
    """The effects of the library that are known to be confused with one."""
    own = load("effects", effect, Effect)
    return [one for one in library(problem) if one.name in own.confusable or own.name in one.confusable]


def alike(problem: Problem) -> list[tuple[str, ...]]:
    """Joints that may share an effect beside usual numbers of their own: those with the same published drive; all, on one bus."""
    drives: dict[bytes, list[str]] = {}
    for joint in problem.joints:
        drives.setdefault(drive_of(problem.robot.model, joint), []).append(joint)
    found = dict.fromkeys([*(tuple(joints) for joints in drives.values()), problem.joints])
    return [group for group in found if len(group) > 1 and group not in problem.groups]


def drive_of(model: mujoco.MjModel, joint: str) -> bytes:
    """What a model publishes of a joint's drive, to compare."""
    index = joint_index(model, joint)
    fields = (model.actuator_gainprm, model.actuator_biasprm, model.actuator_forcerange, model.actuator_gear)
    own = [field[index["actuator"]] for field in fields]
    dof = [field[index["drive"]] for field in (model.dof_damping, model.dof_frictionloss, model.dof_armature)]
    return np.concatenate([*own, dof]).tobytes()


def on_links(problem: Problem, joints: frozenset[str], effect: Effect) -> list[Candidate]:
    """An effect on each link that these joints carry; nothing where it acts on no links."""
    return [c for one in rounds(problem, [effect]) for c in one if carried_by(problem, c) & joints]
