"""Fit: the parameters that make the simulator move as the robot did, what they are worth, and the calibrated model."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from edream import catalog
from edream.calibration.data import sampling_stride, stretches
from edream.calibration.errors import UNSTABLE, before_and_after, commanded, error_table, perfect_tracking, replayed
from edream.calibration.gripping import gripping
from edream.calibration.moves import check_moves
from edream.calibration.pose_objective import PoseObjective
from edream.calibration.problem import FitResult, Fitter, FitterOptions, Problem
from edream.calibration.reservations import numbered, reservations
from edream.calibration.settings import RobotSettings, SpaceSettings, scored, simulated_robot, space_of
from edream.calibration.split import split_motions
from edream.calibration.surrogate import Surrogate
from edream.calibration.sweeping import from_tables
from edream.calibration.windows import Sequences, draw_windows, join, measured_sequences, simulate
from edream.calibration.worth import Worth, worth_of
from edream.core.episode import Episode
from edream.core.errors import require
from edream.core.stage import Artifact, Bundle, Source, Stage, Work
from edream.ingest.causality import beware
from edream.ingest.stored import stored_episodes
from edream.sim.differences import jacobian
from edream.sim.emit import emit
from edream.sim.objective import Objective
from edream.sim.polish import finish
from edream.sim.robot import RobotModel
from edream.sim.servo import asked_positions
from edream.sim.simulation import SimulatedRobot
from edream.sim.touch import kept_clear
from edream.sim.window import whole

MODEL, HOOK = "model.xml", "model_hook.py"
WINDOWS = 32  # recorded windows that the surrogate descends on


@dataclass(frozen=True)
class FitSettings(SpaceSettings):
    """How the search runs; see `conf/fit/default.yaml` for each."""

    method: str = "gauss_newton"
    loss: Literal["joint", "end_effector"] = "joint"
    rotation: Literal["geodesic", "arcsin"] = "geodesic"
    stretch: float = 10.0
    seconds: float = 400.0
    rate: float = 25.0
    search: FitterOptions = field(default_factory=FitterOptions)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.stretch > 0.0, "fit.stretch", self.stretch, "seconds above 0")
        require(self.seconds > 0.0, "fit.seconds", self.seconds, "seconds above 0")
        require(self.rate > 0.0, "fit.rate", self.rate, "samples a second, above 0")


@dataclass(frozen=True)
class SurrogateChoice:
    """The surrogate that was learned, for learning it again."""

    kind: str = "mlp"
    options: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FitConfig:
    """What fit reads."""

    robot: RobotSettings
    fit: FitSettings
    surrogate: SurrogateChoice
    seed: int


def needs(config: FitConfig) -> tuple[str, ...]:
    """A sweep and a surrogate only where the method uses them."""
    entry = catalog.load("fitters", config.fit.method, Fitter)
    return ("ingest", "sweep", "surrogate") if entry.needs_surrogate else ("ingest",)


def run(inputs: Mapping[str, Artifact], config: FitConfig, work: Work) -> Bundle:
    """Split, search, judge, write."""
    settings = config.fit
    train, held = split_motions(list(stored_episodes(inputs["ingest"])), settings, config.seed)
    published = kept_clear(config.robot.load(), train)
    grip = gripping(published, settings.grips, train)
    simulated = simulated_robot(grip.robot, settings, (*train, *held))
    space_of(simulated)
    counted = scored(simulated.robot, settings)
    objective = objective_of(simulated, train, settings, counted)
    check_moves(objective)
    entry = catalog.load("fitters", settings.method, Fitter)
    problem = Problem(objective, None, settings.search, work.seed("search"), counted)
    if entry.needs_surrogate:
        swept = from_tables(inputs["sweep"])
        learned = catalog.load("surrogates", config.surrogate.kind, Surrogate).load(inputs["surrogate"]["weights.safetensors"])
        problem = with_surrogate(problem, swept, learned, config.surrogate.options, train)
    result = work.shards("search", [0], lambda item, rng: _kept(entry.fit(problem)), parallel=False)[0]["found.json"]
    before = objective.simulations
    values, worth = judged(objective, np.array(result["values"]), settings.search.polish if entry.least_squares else 0)
    result = {**result, "simulations": result["simulations"] + objective.simulations - before}
    error = errors(simulated, values, published, train, held, counted, settings.until)
    model = emit(simulated, values, beside=published)
    summary = _summary(worth, error, result, train, held, settings, inputs)
    bundle: dict[str, Any] = {MODEL: model.mjcf, **model.files}
    if grip.joints:
        summary["grips"] = grip.joints
    if model.hook:
        bundle[HOOK] = model.hook
        summary["hook"] = HOOK
    details = {
        "correlation": {"names": list(simulated.space.names), "values": worth.correlation},
        "open_directions": [asdict(direction) for direction in worth.directions],
        "errors_last_rows": worth.lasting,
        "history": result["history"],
        "facts": result["facts"],
        "heldout": [episode.name for episode in held],
        "train": [episode.name for episode in train],
        "model_difference": model.difference,
    }
    replay = overlays(simulated, values, published, [*train, *held], settings.until)
    return bundle | {"summary.json": summary, "details.json": details, "replay.parquet": replay}


def objective_of(simulated: SimulatedRobot, episodes: Sequence[Episode], settings: FitSettings, counted: np.ndarray) -> Any:
    """The loss on the training motions: an `Objective`, or a `PoseObjective` which stands in its place."""
    windows = stretches(episodes, settings.stretch, settings.seconds, settings.until)
    stride = sampling_stride(episodes, settings.rate)
    if settings.loss == "end_effector":
        return PoseObjective(simulated, windows, counted, stride, rotation=settings.rotation)
    return Objective(simulated, windows, counted, stride)


def with_surrogate(
    problem: Problem, sweep: Sequences, learned: Surrogate, options: Mapping[str, float], train: Sequence[Episode]
) -> Problem:
    """The problem with the learned surrogate, recorded windows to descend on, and a way to learn it again."""
    simulated = problem.objective.simulated
    windows = draw_windows(train, sweep.position.shape[1], WINDOWS, np.random.default_rng(problem.seed))

    def relearn(unit: np.ndarray) -> tuple[Surrogate, int]:
        groups = [(unit[i::8], windows[i::8]) for i in range(8)]
        more = join([simulate(simulated, sets, some) for sets, some in groups if len(sets) and some])
        return learned.fit(join([nearest(sweep, unit), more]), options, problem.seed), len(more)

    return replace(problem, measured=measured_sequences(simulated, windows), surrogate=learned, relearn=relearn)


def nearest(sweep: Sequences, unit: np.ndarray) -> Sequences:
    """The third of a sweep whose parameters lie nearest to new ones."""
    distance = ((sweep.unit - unit.mean(axis=0)) ** 2).sum(axis=1)
    return sweep.take(np.argsort(distance, kind="stable")[: max(1, len(sweep) // 3)])


def judged(objective: Any, values: np.ndarray, steps: int) -> tuple[np.ndarray, Worth]:
    """Where up to `steps` more steps with exact Jacobians lead, and intervals and statuses there."""
    if steps:
        end = finish(objective, values, steps)
        return end.values, worth_of(objective, end.values, end.residual, end.jacobian)
    space = objective.simulated.space
    residual = objective.residuals(values)[0]
    return values, worth_of(objective, values, residual, jacobian(objective, space, space.to_unit(values), residual))


def errors(
    simulated: SimulatedRobot,
    values: np.ndarray,
    published: RobotModel,
    train: Sequence[Episode],
    held: Sequence[Episode],
    counted: np.ndarray,
    until: float | None,
) -> dict[str, Any]:
    """Replay errors before and after, on motions that taught and on motions that did not."""
    plain, table = SimulatedRobot(published, ()), {}
    for side, episodes in (("train", train), ("heldout", held)):
        if episodes:
            after = error_table(simulated, values, episodes, counted, until)
            before = error_table(plain, np.zeros(0), episodes, counted, until)
            table[side] = before_and_after(after, before, perfect_tracking(plain, episodes, counted, until))
    return table


def overlays(
    simulated: SimulatedRobot, values: np.ndarray, published: RobotModel, episodes: Sequence[Episode], until: float | None
) -> pa.Table:
    """Measured, commanded and simulated positions of every motion, for pictures: episode, time, and a list over the joints each."""
    windows = whole(episodes, until)
    after, before = replayed(simulated, values, windows), replayed(SimulatedRobot(published, ()), np.zeros(0), windows)
    joints = len(simulated.robot.joints)

    def lists(parts: Sequence[np.ndarray]) -> pa.Array:
        flat = np.concatenate(parts).astype(np.float32).ravel()
        return pa.FixedSizeListArray.from_arrays(pa.array(flat, pa.float32()), joints)

    names = pa.array([w.episode.name for w in windows for _ in range(len(w.times))])
    clock = pa.array(np.concatenate([w.times for w in windows]))
    columns = {
        "measured": [w.measured for w in windows],
        "command": [asked_positions(published.model, published.joints, commanded(w)) for w in windows],
        "before": [np.nan_to_num(one) for one in before],
        "after": [np.nan_to_num(one) for one in after],
    }
    return pa.table({"episode": names, "time": clock, **{name: lists(parts) for name, parts in columns.items()}})


def _kept(result: FitResult) -> Bundle:
    return {"found.json": {k: getattr(result, k) for k in ("values", "cost", "history", "simulations", "converged", "facts")}}


def _summary(
    worth: Worth,
    error: Mapping[str, Any],
    result: Mapping[str, Any],
    train: Sequence[Episode],
    held: Sequence[Episode],
    settings: FitSettings,
    inputs: Mapping[str, Artifact],
) -> dict[str, Any]:
    judge = error["heldout" if held else "train"]
    motions = numbered(len(held), "motion")
    on = f"on {motions} it never saw" if held else "on the motions it was fitted to; none was held out"
    before, rows = judge["before"]["joint_rmse_rad"], judge["before"]["per_episode"].values()
    blown = sum(row["joint_rmse_rad"] == UNSTABLE for row in rows)
    was = f"unstable on {blown} of {len(rows)} motions" if blown else f"off by {before:.4f} rad"
    swept = inputs["sweep"]["summary.json"]["simulations"] if "sweep" in inputs else 0
    return {
        "sentence": f"Your simulator was {was}; it is now off by {judge['joint_rmse_rad']:.4f} rad {on}.{beware([*train, *held])}",
        "model": MODEL,
        "method": settings.method,
        "converged": result["converged"],
        "simulations": result["simulations"] + swept,
        "parameters": {name: asdict(estimate) for name, estimate in worth.estimates.items()},
        "open": reservations(worth, error, len(train)),
        "comparison": comparison(judge),
        "error": error,
    }


def comparison(judge: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The errors that say most, before and after, next to a robot that tracks perfectly; over whole motions and short windows."""
    sides = {"published": judge["before"], "calibrated": judge, "perfect tracking": judge["perfect_tracking"]}
    rows = []
    for name, errors in sides.items():
        if errors is None:
            continue
        row = {"model": name, "whole [rad]": errors["joint_rmse_rad"]}
        spans = {span: at for span, at in errors.get("by_horizon", {}).items() if span != "whole"}
        row |= {f"{span} [rad]": at["joint_rmse_rad"] for span, at in spans.items()}
        rows.append(row | {"hand [m]": errors["translation_m"], "hand [rad]": errors["rotation_rad"]})
    return rows


def sources(config: FitConfig) -> Mapping[str, Source]:
    return {"robot": config.robot.content()}


ENTRY = Stage(
    name="fit", version=34, needs=needs, config=FitConfig, run=run, sources=sources, numerics=("mujoco", "scipy", "cma", "torch")
)
