"""The words of a diagnosis, that a roboticist uses."""

from collections.abc import Sequence
from typing import Literal

from edream.diagnosis.descent import Fit
from edream.diagnosis.left_out import worst_joint
from edream.diagnosis.naming import Named
from edream.diagnosis.problem import Problem
from edream.diagnosis.remainder import Remainder
from edream.diagnosis.swings import main_swing

Verdict = Literal["named", "none", "cannot_tell", "unnamed"]


def sentence(
    verdict: Verdict, effects: Sequence[Named], remainder: Remainder | None, joints: Sequence[str], shows: str = ""
) -> str:
    """What was found in words that a roboticist uses. `agreement` says that nothing was.

    `joints` are all that the robot has; `shows` says where a gap shows that neither a name nor a formula explains.
    """
    parts = _parts(effects, joints)
    if verdict == "unnamed":
        nothing = f"{shows} No formula for it holds on motions left out, either; recordings of more such motions may settle it."
        what = f" It behaves like {remainder.formula} on {remainder.joint}." if remainder else nothing
        beside = f"Your simulator lacks {_and(parts)}, and something else" if parts else "Something real is missing"
        return f"{beside} that no effect in the library explains.{what}"
    if verdict == "cannot_tell":
        doubtful = [one for one in effects if one.confusable_with]
        names = "; ".join(f"{one.name} may be {' or '.join(_short(r, one) for r in one.confusable_with)}" for one in doubtful)
        return f"Your simulator lacks {_and(parts)}, but these motions cannot tell it from others: {names}."
    return f"Your simulator lacks {_and(parts)}."


def contradicted(effects: Sequence[Named], joints: Sequence[str], left: str) -> str:
    """What to say where motions never fitted contradict what was found; `left` says by how much."""
    seems = f"Something real is missing that no effect in the library explains. It resembles {_and(_parts(effects, joints))}"
    return f"{seems} on the motions that were fitted, but others contradict that: {left}. More motions like those may settle it."


def on_steps(problem: Problem, written: Problem, unstable: bool) -> str:
    """What to say where the published time step is too long, for the robot or for a plain loop; nothing otherwise.

    `unstable`: whether the published numbers blow up with it.
    """
    published, searched, last = (
        f"{1e3 * float(robot.model.opt.timestep):.3g} ms" for robot in (problem.robot.published, problem.robot, written.robot)
    )
    found = f" Its steps of {published} are too long for this robot; all of this is with steps of {searched}."
    between = f" A plain loop with steps of {searched} gives commands too early or too late, so model.xml has steps of {last}."
    blown = f" As published it is unstable with steps of {published}." if unstable else ""
    return blown + (found if searched != published else "") + (between if last != searched else "")


def on_creep(problem: Problem) -> str:
    """What to say where dry friction does not hold; nothing otherwise."""
    return " Its dry friction does not hold a stuck joint, which creeps; so it does in model.xml." if problem.creep else ""


def on_the_odd_one(motion: str, shown: Named | None, confirmed: bool, error: float, joint: str) -> str:
    """What to say of a motion that was set aside, since a gap rested on it alone.

    `shown` is what explains it, if anything does, and motions never fitted may confirm it; else it is so far off [rad], most on one
    joint.
    """
    if shown is None:
        off = f"it alone is {1e3 * error:.2g} mrad off, most on {joint}, which nothing that was tried explains"
        return f" {motion} was set aside: {off}, and would bend what the others say."
    others = "those never fitted confirm it" if confirmed else "no other motion confirms it; record more such motions"
    return f" Of the fitted motions {motion} alone shows the {shown.name}; {others}."


def where_it_shows(problem: Problem, fit: Fit) -> str:
    """Where what a model leaves shows most, and whether it swings there in time, as a sentence for the end of another one."""
    joint = worst_joint(problem, fit)
    swing = main_swing(problem, fit, joint)
    swings = f", where it swings at {swing.frequency:.3g} Hz whatever the commands are" if swing else ""
    return f" It shows most on {joint}{swings}."


def _parts(effects: Sequence[Named], joints: Sequence[str]) -> list[str]:
    """Each kind of effect once, with all places where it acts."""
    places: dict[str, list[str]] = {}
    for one in effects:
        places.setdefault(one.summary, []).extend(one.targets)
    return [summary + _on(targets, joints) for summary, targets in places.items()]


def _on(targets: Sequence[str], joints: Sequence[str]) -> str:
    if len(targets) > 2 and set(targets) == set(joints):
        return f" on all {len(joints)} joints"
    return f" on {_and(targets)}" if targets else ""


def _short(rival: str, one: Named) -> str:
    """A rival in words: its name alone where it acts where the effect does, and the joints it leaves out where those are fewer."""
    name, _, place = rival.partition("[")
    theirs = place.removesuffix("]").split("+") if place else []
    left = [joint for joint in one.targets if joint not in theirs]
    if not theirs or not set(theirs) <= set(one.targets) or len(left) >= len(theirs):
        return f"{name} on {_and(theirs)}" if theirs else rival
    return f"{name} without {_and(left)}" if left else name


def _and(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1]
