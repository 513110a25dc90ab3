"""Which effects are hidden on which robot, and recording them: the only part of the blind tests that knows the truth beforehand."""

import hashlib
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from edream.core.errors import EdreamError, unknown_name
from edream.reality.effects import KINDS
from edream.record import RecordConfig, record, truth_path
from edream.sim.robot import RobotModel, load_robot

ROOT = Path(__file__).resolve().parents[2]
SORTS = ("none", "single", "foreign", "pair")
SITES = {"arm6": "ee", "pan_tilt": "ee", "so101": "gripperframe"}
FEWEST_EMPTY = 5
AGAIN = 4  # recordings of a suggested motion
SETTINGS = {"servo_gain": "gain", "hand_weight": "weight"}  # how the make-believe robot is set up as a condition says
PAIRS = (
    ("load_friction", "actuator_delay"),
    ("stribeck", "payload"),
    ("backlash", "constant_torque"),
    ("actuator_lag", "asymmetric_coulomb"),
    ("joint_compliance", "load_friction"),
    ("cogging", "actuator_delay"),
    ("torque_saturation", "parallel_spring"),
    ("dead_zone", "gravity_tilt"),
    ("quadratic_drag", "sensor_delay"),
    ("slew_limit", "position_friction"),
)

Sort = Literal["none", "single", "foreign", "pair"]


@dataclass(frozen=True)
class Case:
    """One blind test.

    Attributes:
        robot: which robot.
        effects: what is hidden.
        seed: of the truth, the motions and the noise.
        sort: what is asked for.
    """

    robot: str
    effects: tuple[str, ...]
    seed: int
    sort: Sort

    @property
    def name(self) -> str:
        return f"{self.robot}/{'+'.join(self.effects) or 'none'}/{self.seed}"

    @property
    def code(self) -> str:
        """A folder name that says nothing."""
        return hashlib.sha256(self.name.encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Session:
    """How long each recording session is: number of motions and their length [s]; and how smooth dry friction is [rad/s]."""

    motions: int = 12
    seconds: float = 10.0
    smooth: float = 0.0


def cases(robots: Sequence[str], sorts: Sequence[str], seeds: int, only: Sequence[str] = (), first: int = 0) -> list[Case]:
    """Every case, one seed after the other and robots in turn, so that a run cut short has seen a bit of everything.

    Args:
        robots: names from `SITES`.
        sorts: names from `SORTS`.
        seeds: how many seeds; cases without effect get at least five.
        only: effects to keep (a pair is kept where both are), or empty for all.
        first: the first seed, so that cases on which a method was worked out need not be those that it is shown on.

    Raises:
        EdreamError: a name does not exist.
    """
    for what, given, known in (("robot", robots, SITES), ("sort of case", sorts, SORTS), ("hidden effect", only, KINDS)):
        for name in given:
            if name not in known:
                raise unknown_name(what, name, known)
    hidden: dict[Sort, list[tuple[str, ...]]] = {
        "none": [()],
        "single": [(name,) for name, kind in KINDS.items() if not kind.foreign],
        "foreign": [(name,) for name, kind in KINDS.items() if kind.foreign],
        "pair": list(PAIRS),
    }
    out = []
    for seed in range(first, first + max(seeds, FEWEST_EMPTY if "none" in sorts else 0)):
        for sort in SORTS:
            if sort in sorts and (seed < first + seeds or sort == "none"):
                chosen = [e for e in hidden[sort] if not only or (set(e) <= set(only) and e)]
                out += [Case(robot, effects, seed, sort) for effects in chosen for robot in robots]
    return out


def drawn(chosen: Sequence[Case], count: int, seed: int) -> list[Case]:
    """So many of some cases, drawn at random, in the order of the draw: however far a run gets, it has seen a fair sample.

    Raises:
        EdreamError: `count` is none of 1 and more.
    """
    if count < 1:
        raise EdreamError(f"--sample is {count}; expected 1 or more of the {len(chosen)} cases.")
    order = np.random.default_rng([seed, 17]).permutation(len(chosen))
    return [chosen[int(i)] for i in order[:count]]


def robot_of(name: str) -> RobotModel | None:
    """A robot's nominal model; None for one that comes with the measurements where those are not here."""
    if name == "so101":
        folder = Path(os.environ.get("EDREAM_SHARED_DATA") or ROOT.parent / "shared" / "data")
        path = folder / "so101" / "so101.xml"
        return load_robot(path, site=SITES[name]) if path.is_file() else None
    return load_robot(ROOT / "edream" / "robots" / f"{name}.xml", site=SITES[name])


def record_case(case: Case, robot: RobotModel, folder: Path, session: Session) -> tuple[Path, Path]:
    """Record one case: recordings under `folder/made`, the truth about them sealed under `folder/truth`; once only.

    Returns:
        The data set and the sealed truth.
    """
    data, sealed = folder / "made" / case.code, folder / "truth" / f"{case.code}.json"
    if not sealed.exists():
        long = {"motions": session.motions, "seconds": session.seconds}
        config = RecordConfig(data, case.effects, format="lerobot_v3", smooth=session.smooth, **long)
        record(robot, config, seed=case.seed)
        sealed.parent.mkdir(parents=True, exist_ok=True)
        truth_path(data).rename(sealed)
    return data, sealed


def record_again(case: Case, robot: RobotModel, folder: Path, motion: Path, conditions: Mapping[str, float]) -> Path:
    """The same robot plays a suggested motion set up as the conditions say, under `folder/again`; returns the data set."""
    data = folder / "again" / case.code
    shutil.rmtree(data, ignore_errors=True)
    known = folder / "truth" / f"{case.code}.json"
    set_up = {SETTINGS[name]: value for name, value in conditions.items()}
    config = RecordConfig(data, case.effects, format="lerobot_v3", motions=AGAIN, motion=motion, truth=known, **set_up)
    record(robot, config, seed=case.seed + 1000)
    truth_path(data).unlink()  # it is the one that lies in `folder/truth`
    return data
