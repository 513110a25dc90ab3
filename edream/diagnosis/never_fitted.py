"""Motions that were never fitted: how far they are off, and what to say of that."""

import numpy as np
from jaxtyping import Bool, Float

from edream.diagnosis.descent import Fit
from edream.diagnosis.left_out import is_borne_out, is_clear, is_real, joint_errors, mean_squares
from edream.diagnosis.problem import Problem
from edream.sim.objective import rms
from edream.sim.rollout import rollout_each

AT_THE_FLOOR = 1.2  # floors of error that are still called agreement
BORNE_OUT = 0.8  # of the gap: names that close less are contradicted,
WORSE = 4.0  # where the squared error here is so many times that on motions left out
OWN = 0.1  # of all that names close on the fitted motions: so much of it is a joint that they are about
MOST = 0.9  # of the squared error: so much of it is nearly all


def proof_squares(problem: Problem, fit: Fit) -> Float[np.ndarray, "K J"]:
    """Mean squared error [rad^2] of each joint that counts in each motion that was never fitted, (K, J)."""
    pairs = zip(_replays(problem, fit), problem.proof, strict=True)
    return np.array([mean_squares(s, w.measured, problem.counted) for s, w in pairs])


def proof_errors(problem: Problem, fit: Fit) -> Float[np.ndarray, "K"]:
    """Mean squared error [rad^2] of each motion that was never fitted, (K,)."""
    return proof_squares(problem, fit).mean(axis=1)


def unstable_on(problem: Problem, fit: Fit) -> tuple[str, ...]:
    """Motions that were never fitted on which the simulation becomes unstable, by name; their errors count nothing."""
    pairs = zip(_replays(problem, fit), problem.proof, strict=True)
    return tuple(w.episode.name for s, w in pairs if not np.isfinite(s).all())


def _replays(problem: Problem, fit: Fit) -> list[Float[np.ndarray, "T J"]]:
    """Simulated positions [rad] in each motion that was never fitted; NaN once unstable."""
    sets = np.tile(fit.values, (len(problem.proof), 1))
    return rollout_each(fit.objective.simulated, sets, problem.proof, problem.settings.threads)


def is_left(problem: Problem, left: Float[np.ndarray, "M"], proof: Float[np.ndarray, "K"]) -> bool:
    """Whether a real gap is left with nothing named, and all motions together bear it out.

    `left` and `proof` are the mean squared errors [rad^2] of motions left out, (M,), and of those never fitted, (K,).
    """
    real = is_real(problem, left) or is_real(problem, proof)
    return real and is_borne_out(problem, np.concatenate([left, proof]), AT_THE_FLOOR)


def about(problem: Problem, without: Fit, beside: Fit) -> Bool[np.ndarray, "J"]:
    """The joints that names are about, (J,): those on which they close much of what they close on the fitted motions."""
    closed = joint_errors(problem, without) ** 2 - joint_errors(problem, beside) ** 2
    own = closed >= OWN * closed.clip(0.0).sum()
    return own if own.any() else np.full(len(closed), True)


def is_contradicted(
    problem: Problem, left: Float[np.ndarray, "M"], without: Fit, beside: Fit, proof: Float[np.ndarray, "K J"]
) -> bool:
    """Whether motions never fitted contradict what was named: a clear gap is left there, and far more than on motions left out.

    A wrong form can follow all that was fitted, and fails elsewhere. A joint that the names are not `about` says nothing of them:
    its servo may reach a limit there that it does not reach in what was fitted.

    Args:
        problem: its floor and its motions.
        left: the mean squared errors [rad^2] on motions left out with what is named, (M,).
        without, beside: the model without and with it.
        proof: mean squared errors [rad^2] with it of each joint in each motion never fitted, (K, J).
    """
    own = about(problem, without, beside)
    before, after = float(proof_squares(problem, without)[:, own].mean()), float(proof[:, own].mean())
    closed = before - after >= BORNE_OUT * (before - problem.floor**2)
    fitted = float((joint_errors(problem, beside)[own] ** 2).mean())  # on these joints, of which the mean over all says less
    return is_clear(problem, proof[:, own]) and not closed and after > WORSE * max(float(left.mean()), fitted)


def agreement(problem: Problem, squares: Float[np.ndarray, "K J"]) -> str:
    """What to say where nothing is named; `squares` are the mean squared errors on motions never fitted [rad^2], (K, J)."""
    if squares.mean() <= (AT_THE_FLOOR * problem.floor) ** 2:
        return "Your simulator agrees with these recordings down to their noise; nothing is missing that they could show."
    left = on_others(problem, squares)
    if is_real(problem, squares):
        misses = f"Your simulator meets the motions that it was fitted to, but misses others: {left}."
        return f"{misses} What is missing, if anything, does not show in the former; more motions may show it."
    return f"Your simulator nearly agrees with these recordings: {left}. That is too little to say what is missing, if anything is."


def on_others(problem: Problem, squares: Float[np.ndarray, "K J"]) -> str:
    """How far motions never fitted are off, in words, and where, if in one place; `squares` as for `agreement`."""
    error, floor = 1e3 * rms(np.sqrt(squares)), 1e3 * problem.floor
    said = f"{error:.2g} mrad on motions never fitted, where noise and repetition explain {floor:.2g}"
    above = (squares - problem.floor**2).clip(0.0)
    joint, motion = int(above.sum(axis=0).argmax()), int(above.sum(axis=1).argmax())
    places = []
    if squares.shape[1] > 1 and above[:, joint].sum() >= MOST * above.sum():
        places.append(f"on {problem.joints[joint]}")
    if len(squares) > 1 and above[motion].sum() >= MOST * above.sum():
        places.append(f"in {problem.proof[motion].episode.name}")
    return said + (f", nearly all of it {' '.join(places)}" if places and is_real(problem, squares) else "")


def still_off(problem: Problem, squares: Float[np.ndarray, "K J"]) -> str:
    """What to say beside names that leave a real gap on motions never fitted; nothing where they do not."""
    return f" Still left: {on_others(problem, squares)}." if is_real(problem, squares) else ""
