"""Contracts of every effect, run on each entry of the catalog without being told."""

import re
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import mujoco
import numpy as np
import pytest

from edream import catalog
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.sim.emit import emit
from edream.sim.robot import RobotModel, load_robot
from edream.sim.rollout import rollout
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.window import whole

ROBOTS = Path(__file__).resolve().parents[2] / "edream" / "robots"
NAMES = catalog.names("effects")
# Structure that is there even where the effect is not: a rotor behind a lock that is stiff, not rigid, and integrated with its own
# implicit damping; a bristle; a filter of no length; a buffer. Everything else is bit-identical or listed below.
ALMOST = {
    "compliance": 5e-4,
    "backlash": 5e-4,
    "presliding": 1e-6,
    "actuator_lag": 1e-6,
    "actuator_delay": 1e-6,
    "sensor_delay": 1e-6,
}
# The same law computed in another place (damping of the joint, not of the servo; a PID in place of a position servo).
MOVED = {"viscous": 1e-6, "slew_limit": 1e-9, "integral_action": 1e-9, "constant_torque": 1e-9}
SLED = """
<mujoco model="sled">
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1" friction="1 0.005 0.0001"/>
    <body name="sled" pos="0 0 0.05">
      <joint name="push" type="slide" axis="1 0 0" damping="1" frictionloss="0.1"/>
      <joint name="up" type="slide" axis="0 0 1"/>
      <geom name="box" type="box" size="0.05 0.05 0.05" mass="1" friction="0.5 0.005 0.0001"/>
    </body>
  </worldbody>
  <actuator><position name="push" joint="push" kp="100" kv="5"/></actuator>
</mujoco>
"""


@cache
def robot(name: str) -> RobotModel:
    if name == "bare":
        return RobotModel("bare", re.sub(r' (armature|damping|frictionloss|kv)="[^"]*"', "", (ROBOTS / "pan_tilt.xml").read_text()))
    return RobotModel("sled", SLED) if name == "sled" else load_robot(ROBOTS / f"{name}.xml", site="ee")


@cache
def episode(name: str, seconds: float = 1.6) -> Episode:
    """Smooth moves, one fast reversal and a hold, of every joint within the middle of its range."""
    one = robot(name)
    model = one.model
    times = np.arange(0.0, seconds, 0.02)
    command = np.empty((len(times), len(one.joints)))
    for column, joint in enumerate(one.joints):
        low, high = model.joint(joint).range if model.joint(joint).limited[0] else (-0.5, 0.5)
        middle, reach = 0.5 * (low + high), min(0.5, 0.3 * (high - low))
        wave = np.sin(2 * np.pi * (0.9 + 0.1 * column) * times) + 0.15 * np.sign(np.sin(2 * np.pi * 0.6 * times + column))
        command[:, column] = middle + 0.2 * reach + reach * np.where(times < 0.75 * seconds, wave, 0.4)
    position = np.repeat(command[:1], len(times), axis=0)
    return Episode("moves", one.joints, times, position, times, command)


def home(effect: Effect) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """A robot, a first place and a second place for an effect."""
    return {
        "joint": ("pan_tilt", ("tilt",), ("pan",)),
        "pair": ("pan_tilt", ("tilt<-pan",), ("pan<-tilt",)),
        "body": ("pan_tilt", ("head",), ("yoke",)),
        "world": ("pan_tilt", (), ()),
        "geom": ("sled", ("box",), ("floor",)),
    }[effect.place]


def load(name: str) -> Effect:
    """The library's entry; with a + behind its name its finer form, with a ~ the one beside friction that creeps."""
    entry = catalog.load("effects", name.rstrip("+~"), Effect)
    other = {"+": entry.finer, "~": entry.creeping}.get(name[-1])
    return other or entry


# and the forms beside friction that creeps, and the finer ones that have one more number which may be absent
FORMS = (
    *NAMES,
    *(f"{n}~" for n in NAMES if load(n).creeping),
    *(
        f"{n}+"
        for n in NAMES
        if (finer := load(n).finer) and finer.parameters(robot("pan_tilt").model, ("tilt",))[-1].absent is not None
    ),
)


def nuisance(name: str) -> tuple[Placement, ...]:
    """Dry friction that holds on every joint, as every calibrated robot has it."""
    return tuple(Placement(load("coulomb"), (joint,)) for joint in robot(name).joints)


def placed(effect: Effect, *targets: tuple[str, ...], where: str) -> SimulatedRobot:
    extra = tuple(Placement(effect, one) for one in targets)
    base = tuple(p for p in nuisance(where) if not (effect.name == "coulomb" and p.targets in targets))
    return SimulatedRobot(robot(where), base + extra)


def play(simulated: SimulatedRobot, values: np.ndarray, where: str) -> np.ndarray:
    return rollout(simulated, values, whole([episode(where)]), threads=1)[0]


def unit_starts(simulated: SimulatedRobot) -> np.ndarray:
    return simulated.space.start()


@cache
def without(where: str) -> np.ndarray:
    simulated = SimulatedRobot(robot(where), nuisance(where))
    return play(simulated, simulated.space.start(), where)


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_says_what_it_is(name: str) -> None:
    effect = load(name)
    assert effect.summary and effect.summary[0].islower() and not effect.summary.endswith(".")
    assert set(effect.confusable) <= set(NAMES) - {name}
    document = type(effect).__doc__ or ""
    assert "Source:" in document and "Parameter" in document
    assert "=" in document or "<=" in document


@pytest.mark.parametrize("name", FORMS)
def test_an_absent_effect_leaves_the_motion_alone(name: str) -> None:
    effect = load(name)
    where, target, _ = home(effect)
    simulated = placed(effect, target, where=where)
    parameters = simulated.space.parameters
    start = simulated.space.start()
    for p in parameters[len(nuisance(where)) :]:
        assert p.absent is None or p.absent == p.start or p.start > p.absent >= p.low, (
            f"{p.name} starts neither absent nor as published"
        )
    gap = np.abs(play(simulated, start, where) - without(where)).max()
    allowed = ALMOST.get(name, MOVED.get(name, 0.0))
    assert gap <= allowed, f"{name} at its start moves the robot by {gap:.2e} rad"


@pytest.mark.parametrize("name", FORMS)
def test_every_parameter_of_an_effect_moves_the_robot(name: str) -> None:
    effect = load(name)
    where, target, _ = home(effect)
    simulated = placed(effect, target, where=where)
    if name != "viscous":  # one number for all damping of a joint, as calibration has it
        damped = [Placement(load("viscous"), (joint,)) for joint in robot(where).joints]
        simulated = simulated.with_placements([*damped, *simulated.placements])
    own = [p for p in simulated.space.parameters if p.name.startswith(effect.name + ".")]
    quantities = [p.name.removeprefix(effect.name + ".").partition("[")[0] for p in own]
    present = effect.probes(robot(where).model, target)[0]
    for p, quantity in zip(own, quantities, strict=True):
        sets = []
        for unit in (0.05, 0.35, 0.65, 0.95):
            values = dict(zip(simulated.space.names, simulated.space.start(), strict=True))
            values |= {
                one.name: 4.0 * present[q] if one.absent == 0.0 else present[q] for one, q in zip(own, quantities, strict=True)
            }
            values = {one.name: float(np.clip(values[one.name], one.low, one.high)) for one in simulated.space.parameters}
            alone = simulated.space.subset([p.name])
            values[p.name] = float(alone.from_unit(np.array([unit]))[0])
            sets.append(simulated.space.vector(values))
        motions = play(simulated, np.array(sets), where)
        moved = np.abs(motions - motions[0]).max()
        assert moved > 1e-6, f"{name}.{quantity} is silently not applied: {moved:.1e} rad"


@pytest.mark.parametrize("name", FORMS)
def test_a_probe_is_inside_the_box_and_visible(name: str) -> None:
    effect = load(name)
    where, target, _ = home(effect)
    simulated = placed(effect, target, where=where)
    probes = effect.probes(robot(where).model, target)
    by_quantity = {p.name: p for p in effect.parameters(robot(where).model, target)}
    sets = []
    for probe in probes:
        assert set(probe) == set(by_quantity)
        for quantity, value in probe.items():
            assert by_quantity[quantity].low <= value <= by_quantity[quantity].high, f"{name}.{quantity} = {value}"
        placement = Placement(effect, target)
        values = dict(zip(simulated.space.names, simulated.space.start(), strict=True))
        sets.append(simulated.space.vector(values | {placement.full_name(q): v for q, v in probe.items()}))
    motions = play(simulated, np.array(sets), where)
    gaps = np.abs(motions - without(where)).max(axis=(1, 2))
    assert np.isfinite(motions).all()
    assert (gaps > 1e-5).any(), f"no probe of {name} shows: {gaps}"


@pytest.mark.parametrize(
    ("name", "where"), [(n, w) for n in FORMS for w in ("pan_tilt", "arm6") if w == "pan_tilt" or load(n).place == "joint"]
)
def test_every_corner_of_the_box_is_finite(name: str, where: str) -> None:
    effect = load(name)
    if where == "arm6":
        target: tuple[str, ...] = ("joint5",)
    else:
        where, target, _ = home(effect)
    simulated = placed(effect, target, where=where)
    own = [i for i, p in enumerate(simulated.space.parameters) if p.name.startswith(effect.name + ".")]
    start = simulated.space.to_unit(simulated.space.start())
    corners = list(product((0.0, 1.0), repeat=len(own))) if len(own) <= 3 else [*np.eye(len(own)), *(1.0 - np.eye(len(own)))]
    sets = np.repeat(start[None], len(corners), axis=0)
    sets[:, own] = corners
    motions = play(simulated, simulated.space.from_unit(sets), where)
    bad = ~np.isfinite(motions).all(axis=(1, 2))
    assert not bad.any(), f"{name} is unstable at {simulated.space.from_unit(sets)[bad][:, own].tolist()}"
    assert np.abs(motions).max() < 50.0


@pytest.mark.parametrize("name", [n for n in NAMES if load(n).place != "world"])
def test_an_effect_stacks_on_two_places(name: str) -> None:
    effect = load(name)
    where, first, second = home(effect)
    probe = effect.probes(robot(where).model, first)[-1]
    both = placed(effect, first, second, where=where)
    values = dict(zip(both.space.names, both.space.start(), strict=True))
    on_first = values | {Placement(effect, first).full_name(q): v for q, v in probe.items()}
    alone = placed(effect, first, where=where)
    kept = {n: on_first[n] for n in alone.space.names}
    gap = np.abs(play(both, both.space.vector(on_first), where) - play(alone, alone.space.vector(kept), where)).max()
    assert gap <= max(1e-9, ALMOST.get(name, MOVED.get(name, 0.0))), (
        f"{name} on {second} at its start changes {first}: {gap:.1e} rad"
    )
    shared = SimulatedRobot(robot(where), (*nuisance(where), Placement(effect, first + second))) if name != "coulomb" else both
    assert np.isfinite(play(shared, shared.space.start(), where)).all()


JOINT_EFFECTS = [n for n in NAMES if load(n).place == "joint"]


@pytest.mark.parametrize("name", JOINT_EFFECTS)
def test_a_joint_that_slides_has_linear_units(name: str) -> None:
    effect, turns = load(name), robot("arm6").model
    sliding = [p.unit for p in Placement(effect, ("push",)).parameters(robot("sled").model)]
    assert not [unit for unit in sliding if "rad" in unit or "N m" in unit]
    turning = [p.unit for p in Placement(effect, ("joint1",)).parameters(turns)]
    assert turning == [p.unit for p in effect.parameters(turns, ("joint1",))]


@pytest.mark.parametrize("name", JOINT_EFFECTS)
def test_an_effect_works_on_a_model_without_armature_damping_or_friction(name: str) -> None:
    simulated = placed(load(name), ("tilt",), where="bare")
    start = simulated.space.mapping(simulated.space.start()) | {Placement(load("coulomb"), ("tilt",)).full_name("torque"): 0.05}
    probes = load(name).probes(robot("bare").model, ("tilt",))
    sets = [start | {Placement(load(name), ("tilt",)).full_name(q): v for q, v in probe.items()} for probe in probes]
    motions = play(simulated, np.array([simulated.space.vector(values) for values in [start, *sets]]), "bare")
    assert np.isfinite(motions).all()
    assert np.abs(motions[1:] - motions[0]).max() > 1e-6


def test_a_torque_limit_holds_the_servos_share_of_the_damping() -> None:
    """The published servo has kv 0.5 beside a joint damping of 0.1: five sixths of any damping are the motor's torque."""
    both = SimulatedRobot(robot("pan_tilt"), tuple(Placement(load(name), ("tilt",)) for name in ("torque_limit", "viscous")))
    published = dict(zip(both.space.names, both.space.start(), strict=True))["torque_limit.inside[tilt]"]
    assert published == pytest.approx(0.5 / 0.6)
    for inside in (published, 0.4):
        values = {"torque_limit.torque[tilt]": 2.0, "torque_limit.inside[tilt]": inside, "viscous.damping[tilt]": 0.9}
        model = mujoco.MjModel.from_xml_string(emit(both, values).mjcf)
        assert model.actuator("tilt").biasprm[2] == pytest.approx(-0.9 * inside)
        assert model.joint("tilt").damping[0] == pytest.approx(0.9 * (1.0 - inside))
        assert model.actuator("tilt").forcerange[1] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("before", "after", "inside"),
    [
        ("", "", 5.0 / 6.0),
        (' forcerange="-5 5"', "", 0.0),
        (' forcerange="-5 5"', ' actuatorfrcrange="-5 5"', 5.0 / 6.0),
    ],
)
def test_what_a_servo_with_a_limit_damps_stays_within_it(before: str, after: str, inside: float) -> None:
    """The published servo has kv 0.5 beside a joint damping of 0.1."""
    published = robot("pan_tilt")
    changed = published.mjcf.replace(before, "").replace('damping="0.10"', f'damping="0.10"{after}')
    simulated = SimulatedRobot(replace(published, mjcf=changed), (Placement(load("viscous"), ("tilt",)),))
    model = mujoco.MjModel.from_xml_string(emit(simulated, {"viscous.damping[tilt]": 0.9}).mjcf)
    assert model.actuator("tilt").biasprm[2] == pytest.approx(-0.9 * inside)
    assert model.joint("tilt").damping[0] == pytest.approx(0.9 * (1.0 - inside))


@pytest.mark.parametrize("kv", [0.3, 0.0])
def test_a_torque_limit_leaves_a_derivative_gain_that_was_found_alone(kv: float) -> None:
    names = ("torque_limit", "viscous", "derivative_gain")
    all_three = SimulatedRobot(robot("pan_tilt"), tuple(Placement(load(name), ("tilt",)) for name in names))
    values = {
        "torque_limit.torque[tilt]": 2.0,
        "torque_limit.inside[tilt]": 0.8,
        "viscous.damping[tilt]": 0.9,
        "derivative_gain.kv[tilt]": kv,
    }
    model = mujoco.MjModel.from_xml_string(emit(all_three, values).mjcf)
    assert model.actuator("tilt").biasprm[2] == pytest.approx(-kv, abs=1e-9)
    assert model.joint("tilt").damping[0] == pytest.approx(0.9)


def test_friction_with_the_load_counts_the_inertia_that_a_gear_moves_and_not_weight_alone() -> None:
    """The pan joint stands upright: gravity never loads it."""
    simulated = placed(load("load_friction"), ("pan",), where="pan_tilt")
    start = dict(zip(simulated.space.names, simulated.space.start(), strict=True)) | {"load_friction.motor_share[pan]": 0.0}
    sets = [simulated.space.vector(start | {"load_friction.slope[pan]": slope}) for slope in (0.0, 0.5)]
    without_, with_ = play(simulated, np.array(sets), "pan_tilt")
    pan = robot("pan_tilt").joints.index("pan")
    assert np.abs(with_ - without_)[:, pan].max() > 1e-4
