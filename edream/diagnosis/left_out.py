"""Errors on motions that a fit did not see, and what they are worth."""

import numpy as np
from jaxtyping import Float, Int

from edream.diagnosis.descent import Fit, step_from
from edream.diagnosis.problem import VISIBLE, Problem, credible
from edream.sim.objective import UNSTABLE_RESIDUAL, rms
from edream.sim.rollout import rollout_each

FOLDS = 5
DRAWS = 4000
FAR = 20.0  # floors of error: so large a gap that refits start from several places
CLEAR = 3.0  # floors: on one joint enough for that where fitted numbers are not credible, which have made up for what is missing
SMALL = 10  # numbers at most, with which that costs little
BRIEF = 120.0  # s of motion, up to which trying is cheap
LENGTHS = (1.0, 0.3)  # of a step
REAL_GAP = 1.8  # floors of error that are a gap worth a name
HALF = 0.5  # of the squared gap: a name that closes less of a real one may be a stand-in
ELSEWHERE = 1.5  # floors of error on a joint where nothing is named: looked into, however large the gap was at first
MATERIAL = 0.05  # of the gap at first, in root-mean-square error, that an effect beside others must close
SEEN = 0.1  # of the floor squared: less than that no usual number is called strange for
SEEN_ORDINARY = 0.05  # the same for an effect with which numbers are ordinary: these say the same thing once more
ASTRAY = 1.2  # times the fit's own error: a motion left out that is so much worse may say more about the step than about the model


def folds(problem: Problem, count: int) -> Int[np.ndarray, "M"]:
    """Which of at most five folds each of `count` motions belongs to, (M,)."""
    return np.random.default_rng([problem.settings.seed, 11]).permutation(count) % min(FOLDS, count)


def left_out_errors(problem: Problem, fit: Fit) -> Float[np.ndarray, "M"]:
    """Mean squared error [rad^2] of each fitted motion when it is left out, (M,); see `left_out_squares`."""
    return left_out_squares(problem, fit).mean(axis=1)


def left_out_squares(problem: Problem, fit: Fit) -> Float[np.ndarray, "M J"]:
    """The same of each joint that counts in each fitted motion when its fold is left out of the last step of the fit, (M, J).

    The fit has arrived, so leaving a fold out moves it by one Gauss-Newton step over the other folds; the fold is then simulated at
    the values that never saw it. Where that makes it much worse than it is in the fit, shorter steps are tried, too.
    """
    windows = fit.objective.windows
    fold = folds(problem, len(windows))
    if far_off(problem, fit) or any(place.effect.rough for place in fit.objective.simulated.placements):
        return _left_out_carefully(fit, fold)
    kept = [fold[fit.objective.owner] != one for one in range(fold.max() + 1)]
    without = np.array([fit.space.from_unit(np.clip(fit.unit + step_from(fit, rows), 0.0, 1.0)) for rows in kept])
    simulated = rollout_each(fit.objective.simulated, without[fold], windows, problem.settings.threads)
    squares = np.array([mean_squares(s, w.measured, problem.counted) for s, w in zip(simulated, windows, strict=True)])
    return squares if squares.mean() <= (ASTRAY * fit.rms) ** 2 else _left_out_carefully(fit, fold)


def _left_out_carefully(fit: Fit, fold: np.ndarray) -> Float[np.ndarray, "M J"]:
    """The same where a whole step may lead astray: that length is taken, none among them, which suits the other motions."""
    owner = fit.objective.owner
    kept = [fold[owner] != one for one in range(fold.max() + 1)]
    steps = [step_from(fit, rows) for rows in kept]
    sets = [np.clip(fit.unit + length * step, 0.0, 1.0) for step in steps for length in LENGTHS]
    squares = fit.objective.residuals(fit.space.from_unit(np.array(sets))) ** 2
    out = np.zeros((len(fold), fit.objective.measured[0].shape[1]))
    for one, rows in enumerate(kept):
        mine = np.vstack([squares[one * len(LENGTHS) : (one + 1) * len(LENGTHS)], fit.residual**2])
        best = mine[int(np.argmin(mine[:, rows].sum(axis=1)))]
        for number in np.flatnonzero(fold == one):
            out[number] = best[owner == number].reshape(-1, out.shape[1]).mean(axis=0)
    return out


def mean_squares(
    simulated: Float[np.ndarray, "T R"], measured: Float[np.ndarray, "T R"], counted: np.ndarray
) -> Float[np.ndarray, "J"]:
    """Mean squared error [rad^2] of each joint that counts, (J,), by a mask over the R recorded ones; the first row is given."""
    residual = np.nan_to_num((simulated - measured)[1:, counted], nan=UNSTABLE_RESIDUAL)
    return (residual**2).mean(axis=0)


def bootstrap(gain: Float[np.ndarray, "M"], seed: int) -> tuple[float, float]:
    """95 % interval of the mean of paired differences, resampling whole motions.

    Source: Efron, Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13 (percentile interval).
    """
    rng = np.random.default_rng([seed, 13])
    means = gain[rng.integers(0, len(gain), (DRAWS, len(gain)))].mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(low), float(high)


def is_real(problem: Problem, errors: Float[np.ndarray, "M"]) -> bool:
    """Whether errors on motions left out are a gap that is worth a name."""
    return float(errors.mean()) > (REAL_GAP * problem.floor) ** 2


def gap_above_floor(problem: Problem, errors: Float[np.ndarray, "M"]) -> float:
    """Mean squared error on motions left out above the floor [rad^2]; of one that cannot be seen, the least that can.

    What one joint is off by may not show in the mean over many.
    """
    return max(float(errors.mean()) - problem.floor**2, least_seen(problem))


def least_seen(problem: Problem) -> float:
    """The least mean squared error above the floor that can be seen [rad^2]."""
    return ((1.0 + VISIBLE) ** 2 - 1.0) * problem.floor**2


def is_borne_out(problem: Problem, errors: Float[np.ndarray, "M"], floors: float) -> bool:
    """Whether mean squared errors [rad^2], (M,), are more than so many `floors`, squared, however their motions are drawn again.

    So not because of one or two of them: the low end of the 95 % bootstrap interval of their mean decides.

    Where a servo at the limit of its torque just holds, or just not, the last digit of a number decides over a whole motion.
    """
    low, _ = bootstrap(errors, problem.settings.seed)
    return low > (floors * problem.floor) ** 2


def does_better(problem: Problem, fit: Fit, other: Fit, seen: float = SEEN) -> bool:
    """Whether a fit meets motions left out better than another one: by what can be seen, however they are drawn, and not one alone.

    Compared are mean squared errors [rad^2] of motions left out, (M,). The one that gains most and the one that loses most do not
    count: where a servo at its limit just holds, or just not, one can be all of the gain or undo it.
    """
    gain = np.sort(left_out_errors(problem, other) - left_out_errors(problem, fit))
    first, last = int(len(gain) > 3), len(gain) - int(len(gain) > 2)  # of two, one says nothing about the other
    gain = gain[first:last]
    low, _ = bootstrap(gain, problem.settings.seed)
    return low > 0.0 and float(gain.mean()) > seen * problem.floor**2


def falls_short(problem: Problem, first: Float[np.ndarray, "M"], left: Float[np.ndarray, "M"]) -> bool:
    """Whether the named effects close less than half of a real gap and leave one: then what is missing has not been found."""
    start, end, floor = float(first.mean()), float(left.mean()), problem.floor**2
    return is_real(problem, left) and start - end < HALF * (start - floor)


def far_off(problem: Problem, fit: Fit) -> bool:
    """Whether the gap is so large, or the fitted numbers so strange beside a clear one, that a linear test points anywhere."""
    if fit.rms > FAR * problem.floor:
        return True
    return joint_errors(problem, fit).max() > CLEAR * problem.floor and not credible(problem, fit.space.mapping(fit.values))


def led_astray(problem: Problem, fit: Fit) -> bool:
    """Whether the fitted numbers may stand in a false valley: far off, and servos reach the limit of their torque."""
    return bool(problem.shared) and far_off(problem, fit)


def leaves_no_gap(problem: Problem, fit: Fit) -> bool:
    """Whether a fit is as near the motions that it was fitted to as one can tell."""
    return fit.rms <= (1.0 + VISIBLE) * problem.floor


def is_small(fit: Fit) -> bool:
    """Whether a model has so few numbers, and its motions are so short, that trying is cheap."""
    return len(fit.unit) <= SMALL and is_brief(fit)


def is_brief(fit: Fit) -> bool:
    """Whether a simulation of all motions costs little."""
    return sum(float(w.times[-1]) for w in fit.objective.windows) <= BRIEF


def joint_errors(problem: Problem, fit: Fit) -> Float[np.ndarray, "J"]:
    """Root-mean-square error [rad] of each joint of the robot that counts, over the fitted motions."""
    return np.sqrt((fit.residual.reshape(-1, len(problem.joints)) ** 2).mean(axis=0))


def worst_joint(problem: Problem, fit: Fit) -> str:
    """The joint that is off most."""
    return problem.joints[int(np.argmax(joint_errors(problem, fit)))]


def gained_on(problem: Problem, joints: frozenset[str], before: Fit, after: Fit) -> float:
    """By how much the root-mean-square error [rad] of some joints is smaller after than before; 0 of none."""
    if not joints:
        return 0.0
    own = np.array([joint in joints for joint in problem.joints])
    return rms(joint_errors(problem, before)[own]) - rms(joint_errors(problem, after)[own])


def is_clear(problem: Problem, errors: Float[np.ndarray, "M"]) -> bool:
    """Whether errors on motions left out are so far above the floor that they ask for a name, however large others were."""
    return float(errors.mean()) > (CLEAR * problem.floor) ** 2


def is_material(
    problem: Problem,
    first: Float[np.ndarray, "M"],
    without: tuple[Float[np.ndarray, "M"], Fit],
    beside: tuple[Float[np.ndarray, "M"], Fit],
    bare: frozenset[str],
) -> bool:
    """Whether an effect beside others gains enough for a name.

    What comes with a large effect and gains little more is mostly that effect's own form, which no formula has exactly. What it
    gains on `bare` joints, on which nothing else is named, is something else, and may be as small as can be seen. So is what leaves
    no real gap of one that is clear: a form that is not exact leaves some, whatever is put beside it.

    Args:
        problem: its floor.
        first: errors on motions left out [rad^2], (M,), with nothing named.
        without: those errors and the fit without the effect; `beside`: with it.
        bare: the joints on which nothing else is named.
    """
    gap = float(np.sqrt(first.mean())) - problem.floor
    gain = float(np.sqrt(without[0].mean()) - np.sqrt(beside[0].mean()))
    closes = is_clear(problem, without[0]) and not is_real(problem, beside[0])
    return gain >= MATERIAL * gap or closes or gained_on(problem, bare, without[1], beside[1]) >= VISIBLE * problem.floor


def asks_for_more(
    problem: Problem, fit: Fit, first: Float[np.ndarray, "M"], errors: Float[np.ndarray, "M"], bare: frozenset[str]
) -> bool:
    """Whether what is left asks for an effect, or for one more.

    It does where it can be seen, and is clear or matters beside the gap at first; where the fit itself is at the floor, only if
    motions left out bear it out together. What is left on a `bare` joint alone, on which nothing is named, the mean over many
    joints hides.

    Args:
        problem: its floor.
        fit: the model as it is.
        first: errors on motions left out [rad^2], (M,), with nothing named; `errors`: as it is, the same where nothing is named.
        bare: the joints on which nothing is named.
    """
    of_joints = dict(zip(problem.joints, joint_errors(problem, fit), strict=True))
    if any(of_joints[joint] > ELSEWHERE * problem.floor for joint in bare):
        return True
    left, whole = (float(np.sqrt(e.mean())) - problem.floor for e in (errors, first))
    small = 0.0 if first is errors or is_clear(problem, errors) else MATERIAL * whole
    if left <= max(VISIBLE * problem.floor, small):
        return False
    return not leaves_no_gap(problem, fit) or is_borne_out(problem, errors, 1.0 + VISIBLE)
