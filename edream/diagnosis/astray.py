"""Candidates where the usual numbers have gone astray: servos at their limit, and numbers that have made up for what is missing."""

from collections.abc import Callable

import numpy as np

from edream.diagnosis.candidates import Candidate
from edream.diagnosis.descent import Fit, begin
from edream.diagnosis.left_out import led_astray, worst_joint
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import Scored, screen
from edream.diagnosis.starts import as_published


def screen_twice(problem: Problem, fit: Fit, done: Callable[[int], object] = lambda n: None) -> list[Scored]:
    """Every effect at every place, best first; from far off, at the servos' limits, also by what it says at published numbers.

    In the false valley to which the usual numbers were led a score test points anywhere. Beside the published numbers of the joint
    that is off most they have not yet made up for anything, and what is missing stands out. Each candidate keeps the better of its
    two shares.
    """
    scored = screen(problem, fit, done)
    if not led_astray(problem, fit):
        return scored
    space = fit.space
    plain = as_published(problem, space.names, fit.values, frozenset({worst_joint(problem, fit)}))
    there = begin(fit.objective, np.clip(space.to_unit(plain), 0.0, 1.0))
    best: dict[Candidate, Scored] = {}
    for one in sorted([*scored, *screen(problem, there, done)], key=lambda s: s.share):
        best[one.candidate] = one
    return sorted(best.values(), key=lambda s: -s.share)
