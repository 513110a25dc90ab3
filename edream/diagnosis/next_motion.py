"""What to record next: commands under which the remaining candidates would move differently."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_factor, cho_solve

from edream.core.effect import holds_position
from edream.core.episode import Episode
from edream.diagnosis.decide import DISTINCT
from edream.diagnosis.descent import Fit
from edream.diagnosis.problem import Problem
from edream.diagnosis.set_up import other_set_ups
from edream.sim.rollout import rollout
from edream.sim.window import Window

SECONDS, RATE, SETTLE = 20.0, 50.0, 1.0
RESTED = round(SETTLE * RATE)  # rows after which a planned motion no longer shows that it began where no servo holds a weight
DRAWN, JUDGED, CHANGED = 24, 3, 5
GLANCED = 8  # of those drawn: where these hardly move any two models apart, the others are not simulated; they choose set-ups, too
FREE = 8  # directions in which the recordings leave a model's numbers most room; the others are taken to be known
MARGIN = 0.05  # of a joint's range is kept free at either end
# of the floor squared: the mean difference that a motion must promise; recorded as often as the others, it tells
TELLING = 2 * DISTINCT
SHORT = 0.8  # of that: where no motion has two models so far apart in its every row, none will in those that count
RISING = 0.4  # of that: what mixtures may bring there
FAINT = 0.1  # of that: so little by those glanced at, others of their kind will not come near it
CLEAR, NEARLY = 5.0, 0.7  # times what must be, where a pair is told for certain; of the most that any set-up gives
IMITATED = 5.0  # times as much is needed before what one model's numbers can do to imitate the other
HASTE = 1.2  # times the fastest command of the recordings


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion to record.

    Attributes:
        joints: names, (J,).
        times: of the commands [s], (K,).
        command: positions [rad or m], (K, J).
        evidence: expected log-likelihood ratio [nat] between the two candidates that are hardest to tell apart, of those it tells.
        told: how many pairs of candidates it tells apart.
        conditions: what has to be set on the robot, and noted with the recordings, as `conditions.csv` has it: a set for each time
            that the motion is to be recorded, an empty one for the robot as it is.
    """

    joints: tuple[str, ...]
    times: Float[np.ndarray, "K"]
    command: Float[np.ndarray, "K J"]
    evidence: float
    told: int
    conditions: tuple[Mapping[str, float], ...]

    def table(self) -> str:
        """The commands as CSV: time [s], a column [rad or m] a joint."""
        rows = [",".join(("time", *self.joints))]
        rows += [",".join(f"{x:.6f}" for x in (t, *row)) for t, row in zip(self.times, self.command, strict=True)]
        return "\n".join(rows) + "\n"


@dataclass(frozen=True, eq=False)
class Room:
    """What the robot may be asked for: positions it has room for, speeds it was commanded before."""

    low: Float[np.ndarray, "J"]
    high: Float[np.ndarray, "J"]
    speed: Float[np.ndarray, "J"]


def suggest(problem: Problem, contenders: Sequence[Fit], rng: np.random.Generator) -> Motion | None:
    """The motion, out of many drawn at random, that best separates models which the recordings cannot tell apart.

    Where the robot as it is leaves pairs untold, motions are looked at under a lower gain of its servos and with a known weight in
    its hand, too: a position servo beside a spring moves as one with another gain and gear ratio does, whatever it is commanded,
    until its gain or its load is another.

    The evidence that a motion would give between two models is the squared difference of their predictions, weighed by the noise
    and by how far each model's own numbers could move to imitate the other,

        E = 1/2 d^T (s^2 I + J C J^T)^-1 d,  d = prediction 1 - prediction 2, J = d prediction / d numbers, C = their covariance;

    the motion with the largest least evidence over all pairs wins; pairs that none separates are left aside. Evidence only counts
    where the difference behind it is one that a verdict would count, too: two names of one thing, such as a delay of the commands
    and one of the measurements, differ a little by where their fits have stopped, which adds up over many measurements.
    Source: Hunter, Reiner, Technometrics 7(3), 1965; Box, Hill, Technometrics 9(1), 1967.

    Args:
        problem: robot, recordings and noise.
        contenders: the fitted models, at least two.
        rng: where chance comes from.

    Returns:
        The motion; None where no motion would tell any two of them apart, or some joint takes no positions as commands.
    """
    if not all(holds_position(problem.robot.model, joint) for joint in problem.fitted[0].episode.joints):
        return None
    room, visible, under = room_of(problem), TELLING * problem.floor**2, [{}, *other_set_ups(problem)]
    drawn = [draw(room, rng) for _ in range(DRAWN)]
    near = np.array([separations(problem, contenders, drawn[:GLANCED], one).max(axis=0) for one in under])
    if near.max() < FAINT * visible:
        return None
    promised = int((near.max(axis=0) >= SHORT * visible).sum())
    likely = [under[number] for number in fewest(near, SHORT * visible, IMITATED * CLEAR * visible)] if promised else under
    found = best_under(problem, contenders, drawn, rng, likely)
    if len(likely) == len(under) or (found is not None and found.told >= promised):
        return found
    more = best_under(problem, contenders, drawn, rng, under)
    return more if more is not None and (found is None or more.told > found.told) else found


def best_under(
    problem: Problem,
    contenders: Sequence[Fit],
    drawn: Sequence[np.ndarray],
    rng: np.random.Generator,
    under: Sequence[Mapping[str, float]],
) -> Motion | None:
    """The best motion to play under some conditions, drawn or a mixture; None where none tells two models apart.

    The conditions are those of the first recording but for what each says. The fewest that tell as many pairs, and clearly,
    are kept, earlier ones rather than later ones.
    """

    def apart(motions: Sequence[np.ndarray]) -> np.ndarray:
        return np.max([separations(problem, contenders, motions, one) for one in under], axis=0)

    def promising(motions: Sequence[np.ndarray], distances: np.ndarray) -> list[np.ndarray]:
        order = np.argsort(-_least(distances, RISING * visible), kind="stable")[:JUDGED]
        return [motions[i] for i in order]

    visible, near = TELLING * problem.floor**2, apart(drawn)
    best = promising(drawn, near)
    mixtures = [mixed(one, drawn[int(rng.integers(DRAWN))], rng) for one in best for _ in range(CHANGED)]
    further = apart(mixtures)
    if max(near.max(), further.max()) < SHORT * visible:
        return None  # before what their numbers can make up for, which takes long to simulate
    best += promising(mixtures, further)
    worth = 0.5 * TELLING * (len(best[0]) - RESTED) * int(problem.counted.sum()) / problem.settings.stride
    each = np.array([evidences(problem, contenders, best, one) for one in under])
    sure = _least(each.max(axis=0), worth)
    winner = int(np.argmax(sure))
    if sure[winner] < worth:
        return None
    told = int((each[:, winner].max(axis=0) >= worth).sum())
    chosen = fewest(each[:, winner], worth, CLEAR * worth)
    times = np.arange(len(best[winner])) / RATE
    conditions = tuple(dict(under[number]) for number in chosen)
    return Motion(problem.fitted[0].episode.joints, times, best[winner], float(sure[winner]), told, conditions)


def fewest(apart: Float[np.ndarray, "conditions pairs"], worth: float, clear: float) -> tuple[int, ...]:
    """The fewest conditions under which every pair that any of them tells is clearly apart, or nearly as far as under any of them.

    Of as many, those that come first; a pair is told from `worth` on, and apart for certain from `clear` on.
    """
    most = apart.max(axis=0)
    tells = (most >= worth) & (apart >= np.minimum(clear, NEARLY * most))
    sets = (some for size in range(1, len(apart) + 1) for some in combinations(range(len(apart)), size))
    return next(some for some in sets if (tells[list(some)].any(axis=0) == (most >= worth)).all())


def _least(pairs: Float[np.ndarray, "M pairs"], worth: float) -> Float[np.ndarray, "M"]:
    """The least of each motion over the pairs that some motion separates by `worth`; 0 where there is no such pair."""
    told = pairs.max(axis=0) >= worth
    return pairs[:, told].min(axis=1) if told.any() else np.zeros(len(pairs))


def room_of(problem: Problem) -> Room:
    """The room that the model's limits and the recordings leave."""
    model, joints = problem.robot.model, problem.fitted[0].episode.joints
    commands = [w.episode.command for w in problem.fitted]
    clocks = [w.episode.command_times for w in problem.fitted]
    seen_low, seen_high = np.min([c.min(axis=0) for c in commands], axis=0), np.max([c.max(axis=0) for c in commands], axis=0)
    low, high = seen_low.copy(), seen_high.copy()
    for j, name in enumerate(joints):
        number = model.joint(name).id
        if model.jnt_limited[number]:
            low[j], high[j] = model.jnt_range[number]
            margin = MARGIN * (high[j] - low[j])
            # not far from where the robot has been: the model knows nothing of tables and cables
            reach = 0.1 * (seen_high[j] - seen_low[j])
            low[j], high[j] = max(low[j] + margin, seen_low[j] - reach), min(high[j] - margin, seen_high[j] + reach)
            low[j], high[j] = min(low[j], high[j]), max(low[j], high[j])
    speeds = [np.abs(np.diff(c, axis=0)) / np.diff(t)[:, None] for c, t in zip(commands, clocks, strict=True)]
    return Room(low, high, HASTE * np.max([np.percentile(s, 99, axis=0) for s in speeds], axis=0))


def draw(room: Room, rng: np.random.Generator) -> Float[np.ndarray, "K J"]:
    """One motion: from pose to pose at every speed, with holds, small moves to and fro, and sudden steps."""
    rows = round(SECONDS * RATE)
    out = [np.tile(rng.uniform(room.low, room.high), (round(SETTLE * RATE), 1))]
    while sum(map(len, out)) < rows:
        here = out[-1][-1]
        sort = int(rng.integers(4))
        if sort == 0:
            out.append(_line(here, rng.uniform(room.low, room.high), room, rng.uniform(0.1, 1.0)))
        elif sort == 1:
            out.append(_line(here, here, room, 1.0, round(rng.uniform(0.4, 1.5) * RATE)))
        elif sort == 2:
            near = np.clip(here + rng.uniform(-0.25, 0.25, len(here)) * (room.high - room.low), room.low, room.high)
            out += [_line(here, near, room, share := rng.uniform(0.05, 0.6)), _line(near, here, room, share)]
        else:
            which = rng.integers(len(here))
            there = here.copy()
            there[which] = rng.uniform(room.low[which], room.high[which])
            out += [_line(here, there, room, 1.0), _line(there, there, room, 1.0, round(0.7 * RATE))]
    return np.concatenate(out)[:rows]


def _line(start: np.ndarray, end: np.ndarray, room: Room, share: float, rows: int | None = None) -> Float[np.ndarray, "K J"]:
    """Rows from one pose to another at a share of the largest speed."""
    if rows is None:
        need = np.abs(end - start) / np.maximum(share * room.speed, 1e-6)
        rows = int(np.clip(np.ceil(need.max() * RATE), 2, SECONDS * RATE))
    return start + (end - start) * np.linspace(1.0 / rows, 1.0, rows)[:, None]


def mixed(one: np.ndarray, other: np.ndarray, rng: np.random.Generator) -> Float[np.ndarray, "K J"]:
    """Some joints of one motion with the others of another."""
    return np.where(rng.random(one.shape[1]) < 0.5, one, other)


def as_window(problem: Problem, command: Float[np.ndarray, "K J"], conditions: Mapping[str, float]) -> Window:
    """A planned motion as something that can be simulated; it has no measurement but its start.

    Its conditions are those of the first recording, but for those that are given.
    """
    sample = problem.fitted[0].episode
    times = np.arange(len(command)) / RATE
    episode = Episode("planned", sample.joints, times, command, times, command, conditions={**sample.conditions, **conditions})
    return Window(episode, 0, len(times) - 1)


def separations(
    problem: Problem, contenders: Sequence[Fit], motions: Sequence[np.ndarray], conditions: Mapping[str, float]
) -> Float[np.ndarray, "M pairs"]:
    """Mean squared difference [rad^2] between every two models' predictions of each motion."""
    windows = [as_window(problem, one, conditions) for one in motions]
    predicted = [rollout(f.objective.simulated.swift, f.values, windows, problem.settings.threads) for f in contenders]
    pairs = list(combinations(predicted, 2))
    apart = [[np.mean((a[m][0] - b[m][0])[RESTED:, problem.counted] ** 2) for a, b in pairs] for m in range(len(motions))]
    return np.nan_to_num(np.array(apart), nan=0.0)


def evidences(
    problem: Problem, contenders: Sequence[Fit], motions: Sequence[np.ndarray], conditions: Mapping[str, float]
) -> Float[np.ndarray, "M pairs"]:
    """Expected log-likelihood ratio [nat] between every two models over each motion."""
    windows = [as_window(problem, one, conditions) for one in motions]
    predictions = [_with_slopes(problem, fit, windows) for fit in contenders]
    out = []
    for m in range(len(motions)):
        pairs = combinations([one[m] for one in predictions], 2)
        out.append([min(_evidence(problem, a, b), _evidence(problem, b, a)) for a, b in pairs])
    return np.nan_to_num(np.array(out), nan=0.0)


def _with_slopes(problem: Problem, fit: Fit, windows: Sequence[Window]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Predictions (R,) of each window, and how they move within the numbers' uncertainty, (R, FREE).

    In a direction that the recordings tell, a new motion is taken to have no room: over all of its measurements that would be about
    as much as the noise of one.
    """
    size, turn = np.linalg.eigh(fit.covariance())
    root = (turn * np.sqrt(np.maximum(size, 0.0)))[:, -FREE:]
    steps = 0.05 * root.T
    sets = np.clip(np.vstack([fit.unit, fit.unit + steps]), 0.0, 1.0)
    results = rollout(fit.objective.simulated.swift, fit.space.from_unit(sets), windows, problem.settings.threads)
    flat = [r[:, RESTED :: problem.settings.stride, problem.counted].reshape(len(sets), -1) for r in results]
    return [(f[0], (f[1:] - f[0]).T / 0.05) for f in flat]


def _evidence(problem: Problem, one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> float:
    """1/2 d^T (s^2 I + L L^T)^-1 d by Woodbury's identity, L the slopes of the model that tries to imitate the other."""
    noise = problem.floor
    difference, slopes = (one[0] - other[0]) / noise, other[1] / noise
    inner = cho_factor(np.eye(slopes.shape[1]) + slopes.T @ slopes)
    projected = slopes.T @ difference
    return 0.5 * float(difference @ difference - projected @ cho_solve(inner, projected))
