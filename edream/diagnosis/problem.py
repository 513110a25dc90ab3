"""What a diagnosis works on: the recordings it may fit, those it may not, the model's known unknowns and the noise floor."""

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Float

from edream.catalog import load
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.diagnosis.kept_back import drawn, named
from edream.sim.robot import RobotModel, joint_groups
from edream.sim.simulation import USUAL, Placement, Scaling
from edream.sim.touch import kept_clear
from edream.sim.window import Window, at_rest, whole

CREDIBLE_FACTOR = 2.5
SHORTEST = 4.0  # s
FEWEST = 4  # motions, of which some are kept for the proof
PIECES, MOST_PIECES, PIECE = 8, 40, 12.0  # how many pieces fewer motions are cut into, and how long they are [s] in between
LEAST_ROWS = 20  # measurements of a motion
OUTLYING = (0.5, 99.5)  # percentiles of the positions between which a joint moved
STILL = 0.02  # rad
VISIBLE = 0.1  # of the floor: with nothing hidden, less is left over it
NOMINAL_SPREAD = math.log(1.35)


@dataclass(frozen=True)
class Settings:
    """What a diagnosis is told.

    Attributes:
        nuisance: effects that every real robot has, refitted beside each candidate; all others are candidates.
        ties: groups of joints that share hardware and so may share numbers.
        scaled: parameter "effect.quantity" -> the recorded condition that multiplies it.
        limits: parameter "effect.quantity" -> fields of `Parameter` known from a datasheet (start, low, high, spread).
        effects: candidates by name, or empty for the whole library.
        ignored: effects that are left out.
        joints: joints whose error counts, or empty for all.
        until: seconds of each motion that are used, or None for all.
        seconds: so many seconds of motion are fitted in all, one stretch of each motion; the proof replays whole motions.
        proof: share of the motions that is kept for the proof and never fitted; see `kept_back.drawn`.
        holdout: names or patterns of motions kept for the proof, instead of a share.
        stride: every how many measurements one counts.
        model_floor: disagreement [rad] that two correct simulators may have, by their integration.
        gain: smallest share of the remaining gap that an effect must close on motions it was not fitted to.
        most: most effects that are named.
        seed: of the split and the bootstrap.
        threads: simulation threads, 0 for all.
    """

    nuisance: tuple[str, ...] = ("servo_gain", "viscous", "coulomb", "armature")
    ties: tuple[tuple[str, ...], ...] = ()
    scaled: Mapping[str, Scaling] = field(default_factory=lambda: dict(USUAL))
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    effects: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()
    until: float | None = None
    seconds: float = 160.0
    proof: float = 0.25
    holdout: tuple[str, ...] = ()
    stride: int = 1
    model_floor: float = 1.5e-4
    gain: float = 0.10
    most: int = 4
    seed: int = 0
    threads: int = 0


@dataclass(frozen=True, eq=False)
class Problem:
    """One diagnosis, made ready.

    Attributes:
        robot: the published (or calibrated) model.
        settings: what it was told.
        groups: the robot's joints in groups that share hardware; those that count in none are left as published.
        fitted: windows that may be fitted, one a motion.
        proof: windows of the motions that are never fitted.
        counted: which joints' errors count, (J,).
        noise: standard deviation of each joint's measurement [rad], (J,).
        shared: groups whose motions tell how much of the damping is the servo's, within its torque limit.
        creep: dry friction in a form that lets a stuck joint creep, where the motions ask for it.
    """

    robot: RobotModel
    settings: Settings
    groups: tuple[tuple[str, ...], ...]
    fitted: tuple[Window, ...]
    proof: tuple[Window, ...]
    counted: np.ndarray
    noise: Float[np.ndarray, "J"]
    shared: tuple[tuple[str, ...], ...] = ()
    creep: Effect | None = None

    @property
    def noise_floor(self) -> float:
        """Root mean square of the measurement noise over the joints that count [rad]."""
        return float(np.sqrt(np.mean(self.noise[self.counted] ** 2)))

    @property
    def floor(self) -> float:
        """What a true simulator would leave [rad]: measurement noise and the integration's own error."""
        return math.hypot(self.noise_floor, self.settings.model_floor)

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that are commanded, recorded and counted."""
        names = self.fitted[0].episode.joints
        return tuple(name for name, counts in zip(names, self.counted, strict=True) if counts)

    @cached_property
    def narrowed(self) -> mujoco.MjModel:
        """The robot's model, each joint's range where the fitted motions went: for effects that act at one place of its travel."""
        model = copy.copy(self.robot.model)
        for column, name in enumerate(self.fitted[0].episode.joints):
            visited = np.concatenate([window.measured[:, column] for window in self.fitted])
            low, high = np.percentile(visited, OUTLYING)
            if high - low >= STILL:
                joint = model.joint(name).id
                model.jnt_limited[joint], model.jnt_range[joint] = 1, (low, high)
        return model


def prepare(robot: RobotModel, episodes: Sequence[Episode], settings: Settings) -> Problem:
    """Split the motions, group the joints and measure the noise.

    Raises:
        EdreamError: too little motion, a name that does not exist, or a noted condition that scales no fitted number.
    """
    joints = episodes[0].joints
    for name, one in USUAL.items():
        if name.partition(".")[0] not in settings.nuisance and any(one.condition in e.conditions for e in episodes):
            raise EdreamError(
                f"A recording notes {one.condition} in conditions.csv, which scales {name}, but robot.nuisance has no "
                f"{name.partition('.')[0]}. Add it."
            )
    for name in settings.joints:
        robot.joint_index(name)
    counted = np.array([not settings.joints or joint in settings.joints for joint in joints])
    windows = motions(episodes, settings)
    kept = named(windows, settings.holdout) if settings.holdout else drawn(windows, counted, settings.proof, settings.seed)
    return Problem(
        robot=replace(kept_clear(robot, episodes), timed=True),
        settings=settings,
        groups=tuple(joint_groups(robot, settings.ties, settings.joints)),
        fitted=tuple(shortened([w for w in windows if w.episode.name not in kept], settings)),
        proof=tuple(w for w in windows if w.episode.name in kept),
        counted=counted,
        noise=measurement_noise(episodes),
    )


def motions(episodes: Sequence[Episode], settings: Settings) -> list[Window]:
    """What counts as a motion: an episode, or, where there are fewer than four, stretches of them.

    Raises:
        EdreamError: too little motion to keep some for the proof.
    """
    windows = [window for window in whole(episodes, settings.until) if window.last - window.first >= LEAST_ROWS]
    if len(windows) >= FEWEST:
        return windows
    seconds = sum(episode.duration for episode in episodes)
    count = min(max(PIECES, round(seconds / PIECE)), int(seconds / SHORTEST), MOST_PIECES)
    pieces = at_rest(episodes, count, settings.until) if count >= FEWEST else []
    pieces = [window for window in pieces if window.last - window.first >= LEAST_ROWS]
    if len(pieces) < FEWEST:
        raise EdreamError(
            f"A diagnosis needs at least {FEWEST} motions, so that some are never fitted, or a recording that can be cut into as "
            f"many of {SHORTEST:.0f} s; the data lasts {seconds:.1f} s in all (recordings: {len(episodes)}). Record more."
        )
    return pieces


def shortened(windows: Sequence[Window], settings: Settings) -> list[Window]:
    """A stretch of each motion, from a row drawn by seed, all of them together as long as the settings say, none under 4 s."""
    share = max(SHORTEST, settings.seconds / max(len(windows), 1))
    rng = np.random.default_rng([settings.seed, 5])
    out = []
    for window in windows:
        times = window.times
        latest = int(np.searchsorted(times, times[-1] - share, side="right")) - 1
        first = int(rng.integers(0, latest + 1)) if latest > 0 else 0
        last = int(np.searchsorted(times, times[first] + share, side="right")) - 1
        out.append(window if times[-1] <= share else Window(window.episode, window.first + first, window.first + last))
    return out


def measurement_noise(episodes: Sequence[Episode]) -> Float[np.ndarray, "J"]:
    """Standard deviation of each joint's measurement [rad], (J,).

    The larger of the encoder step's (step / sqrt 12) and that of the third differences of the position (scaled by sqrt 20) over
    the quieter half of the recording, where the motion itself has none to speak of.
    """
    columns = []
    for joint in range(episodes[0].position.shape[1]):
        third = np.concatenate([np.diff(e.position[:, joint], 3) for e in episodes])
        speed = np.concatenate([np.abs(e.position[3:, joint] - e.position[:-3, joint]) for e in episodes])
        quiet = np.abs(third[speed <= np.median(speed)])
        spread = 1.4826 * float(np.median(quiet)) / math.sqrt(20.0)
        columns.append(max(spread, encoder_step(episodes, joint) / math.sqrt(12.0)))
    return np.array(columns)


def encoder_step(episodes: Sequence[Episode], joint: int) -> float:
    """Smallest step of a joint's encoder [rad]: the 5th percentile of the non-zero differences between sorted readings."""
    readings = np.unique(np.concatenate([np.round(e.position[:, joint], 7) for e in episodes]))
    gaps = np.diff(readings)
    gaps = gaps[gaps > 1e-6]
    return float(np.percentile(gaps, 5)) if len(gaps) > 20 else 0.0


def nuisance_placements(problem: Problem, fitted: Mapping[str, float] | None = None) -> tuple[Placement, ...]:
    """The effects that every real robot has, on each group of joints.

    Priors: a published number is believed to within 35 % (one standard deviation). Where a first fit without priors (`fitted`)
    leads away from it by more than a factor of 2.5, the published number is not credible and the prior becomes a wide one around
    the fitted value.
    """
    placements = []
    for name in problem.settings.nuisance:
        for group in problem.groups:
            effect = load("effects", name, Effect)
            if name == "viscous" and group in problem.shared and effect.finer:
                effect = effect.finer
            if problem.creep is not None and name == problem.creep.name:
                effect = problem.creep
            bare = Placement(effect, group, scaled=scaling_of(problem, name))
            bounds = {}
            for short, full in _names(bare, problem):
                known = dict(problem.settings.limits.get(f"{name}.{short}", {}))
                parameter = next(p for p in effect.parameters(problem.robot.model, group) if p.name == short)
                bounds[short] = known | _prior(replace(parameter, **known), None if fitted is None else fitted.get(full))
            placements.append(Placement(effect, group, scaled=bare.scaled, bounds=bounds))
    return tuple(placements)


def credible(problem: Problem, fitted: Mapping[str, float]) -> bool:
    """Whether all numbers that the model publishes are fitted within a factor of 2.5 of what it says (guesses and zeros aside).

    `fitted` holds them by full parameter name; what is not in it stands as published.
    """
    model = problem.robot.model
    for place in nuisance_placements(problem):
        for parameter, full in zip(place.effect.parameters(model, place.targets), place.parameters(model), strict=True):
            known = full.name in fitted and parameter.start > 0.0 and not parameter.guessed
            if known and not 1.0 / CREDIBLE_FACTOR <= fitted[full.name] / parameter.start <= CREDIBLE_FACTOR:
                return False
    return True


def _names(placement: Placement, problem: Problem) -> list[tuple[str, str]]:
    parameters = placement.effect.parameters(problem.robot.model, placement.targets)
    return [(p.name, placement.full_name(p.name)) for p in parameters]


def _prior(parameter, fitted: float | None) -> dict[str, float]:
    if fitted is None:
        return {}
    nominal = parameter.start
    ratio = (fitted + 1e-12) / (nominal + 1e-12)
    credible = nominal > 0.0 and not parameter.guessed and 1.0 / CREDIBLE_FACTOR <= ratio <= CREDIBLE_FACTOR
    centre = nominal if credible else float(np.clip(fitted, parameter.low, parameter.high))
    if parameter.scale == "log":
        return {"start": centre, "spread": NOMINAL_SPREAD if credible else 1.0}
    scale = max(centre, 0.02 * (parameter.high - parameter.low))
    return {"start": centre, "spread": (0.5 if credible else 1.0) * scale}


def scaling_of(problem: Problem, effect: str) -> dict[str, Scaling]:
    """Which quantities of an effect a recorded condition multiplies."""
    return {key.split(".")[1]: scaling for key, scaling in problem.settings.scaled.items() if key.split(".")[0] == effect}
