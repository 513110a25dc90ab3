"""A search for effects whose error has many valleys, such as play in a gear, where no descent from the usual numbers arrives.

Source: Hansen, The CMA Evolution Strategy: A Tutorial, 2016 (CMA-ES by `cma`).
"""

import cma
import numpy as np

from edream.core.parameters import targets_in
from edream.diagnosis.candidates import Candidate, can_act, library, placement, probes_of
from edream.diagnosis.descent import Fit, begin, descend
from edream.diagnosis.left_out import worst_joint
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import acts_already, extend, fits_beside, lightened, with_quantities
from edream.sim.objective import rms

GENERATIONS, CHILDREN = 14, 16
WIDE = 0.05  # of a parameter's range: the first standard deviation where no prior is narrower
HOPELESS = 0.5  # of the least gain that counts, to be there before all numbers go down together


def rough_candidates(problem: Problem, fit: Fit) -> list[Candidate]:
    """The rough effects of the library on the joint that is furthest off."""
    joint = worst_joint(problem, fit)
    found = [Candidate(effect.name, (joint,)) for effect in library(problem) if effect.rough and can_act(problem, effect, joint)]
    present = fit.objective.simulated.placements
    return [c for c in found if not acts_already(c, present) and fits_beside(problem, fit, [c])]


def searched(problem: Problem, fit: Fit, candidate: Candidate) -> Fit | None:
    """The fit with a rough effect on one joint, its usual numbers begun at the centres of their priors; None if hopeless.

    The centres, which have not made up for the effect, are the published numbers where those are credible; effects found before
    stay as they are. CMA-ES over the joint's own numbers on a few motions, then a descent of all numbers on all motions.
    """
    place = placement(problem, candidate)
    extended, absent = extend(fit, [place])
    space, (few, _) = extended.simulated.space, extend(lightened(problem, fit), [place])
    own = np.array([candidate.targets[0] in targets_in(name) for name in space.names])
    probes = probes_of(problem, place)
    sets = np.array([with_quantities(extended, absent, [place], [probe]) for probe in probes])
    usual = own & np.array([name.partition(".")[0] in problem.settings.nuisance for name in space.names])
    sets[:, usual] = space.start()[usual]
    units = np.clip(space.to_unit(sets), 0.0, 1.0)
    start = units[int(np.argmin([rms(r) for r in few.residuals(space.from_unit(units))]))]
    spread = np.minimum(space.unit_prior()[1], WIDE)[own]
    options = {"popsize": CHILDREN, "seed": problem.settings.seed + 1, "bounds": [0, 1], "verbose": -9, "CMA_stds": list(spread)}
    strategy = cma.CMAEvolutionStrategy(start[own], 1.0, options)
    for _ in range(GENERATIONS):
        children = np.tile(start, (CHILDREN, 1))
        children[:, own] = asked = np.array(strategy.ask())
        strategy.tell(list(asked), [rms(r) for r in few.residuals(space.from_unit(children))])
    without = rms(few.residuals(absent[None])[0])
    if strategy.result.fbest**2 > (1.0 - HOPELESS * problem.settings.gain) * without**2:
        return None  # a descent of all numbers on all motions takes far longer than this search
    best = start.copy()
    best[own] = np.clip(np.array(strategy.result.xbest, dtype=float), 0.0, 1.0)
    return descend(begin(extended, best), None, 4)
