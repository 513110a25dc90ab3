"""The emitted model, replayed in stock MuJoCo without edream, moves as the simulation that was judged."""

import importlib.util
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco import batch

from edream import catalog
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.diagnosis.remainder import ResidualTorque
from edream.sim.emit import emit
from edream.sim.hooks import BatchState
from edream.sim.robot import load_robot
from edream.sim.rollout import rollout
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.window import whole

NAMES = [name for name in catalog.names("effects") if name != "contact_friction"]
ROBOT = load_robot(Path(__file__).resolve().parents[2] / "edream" / "robots" / "pan_tilt.xml", site="ee")
FORMS = [*NAMES, "load_friction+", "coulomb~"]  # and one finer form, which has a hook of its own, and one that is softer
PLACES = {"joint": ("tilt",), "pair": ("tilt<-pan",), "body": ("head",), "world": ()}


def motion() -> Episode:
    times = np.arange(0.0, 2.0, 0.0201)
    command = np.stack([0.5 * np.sin(5.0 * times) + 0.1, 0.4 * np.sin(7.3 * times) - 0.3 + 0.2 * (times > 1.0)], axis=1)
    return Episode("moves", ROBOT.joints, times, np.repeat(command[:1], len(times), axis=0), times, command)


def with_effect(name: str) -> tuple[SimulatedRobot, dict[str, float]]:
    """The pan-tilt with odd friction and gain, and a visible version of one effect."""
    effect = catalog.load("effects", name.rstrip("+~"), Effect)
    effect = effect.finer if name.endswith("+") and effect.finer else effect
    effect = effect.softer[0] if name.endswith("~") else effect
    base = [Placement(catalog.load("effects", n, Effect), (j,)) for n in ("coulomb", "servo_gain") for j in ROBOT.joints]
    own = Placement(effect, PLACES[effect.place])
    base = [p for p in base if (p.effect.name, p.targets) != (effect.name, own.targets)]
    simulated = SimulatedRobot(ROBOT, (*base, own))
    values = dict(zip(simulated.space.names, simulated.space.start() * 1.0123456789012, strict=True))
    values |= {own.full_name(q): v for q, v in effect.probes(ROBOT.model, own.targets)[-1].items()}
    return simulated, values


def stock(model: mujoco.MjModel, hook: object, episode: Episode) -> np.ndarray:
    """A plain loop as anyone would write it: hold commands, step, interpolate at the measured times."""
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in episode.joints]
    for joint, reading in zip(joints, episode.position[0], strict=True):
        driving = [a for a in range(model.nactuator) if model.actuator_trnid[a, 0] == joint.id]
        position = reading / (model.actuator_gear[driving[0], 0] if driving else 1.0)  # gear_ratio: an encoder before the gear
        data.qpos[joint.qposadr] = position
        twin = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint.name + "_motor")
        if twin >= 0:
            data.qpos[model.jnt_qposadr[twin]] = position
    step = hook.make(model) if hook else None
    grid = [np.array([data.qpos[joint.qposadr[0]] for joint in joints])]
    sensed = [None]
    for k in range(int(np.ceil(episode.times[-1] / model.opt.timestep)) + 1):
        row = np.searchsorted(episode.command_times, k * model.opt.timestep + 1e-9, side="right") - 1
        data.ctrl[:] = episode.command[row]
        if step:
            step(model, data)
        mujoco.mj_step(model, data)
        grid.append(np.array([data.qpos[joint.qposadr[0]] for joint in joints]))
        if model.nsensor:
            sensed.append(np.array([data.sensor(name + "_measured").data[0] for name in episode.joints]))
    if model.nsensor:
        grid = sensed[1:]  # a sensor describes the state before the step
    clock = model.opt.timestep * np.arange(len(grid))
    return np.stack([np.interp(episode.times, clock, np.array(grid)[:, j]) for j in range(len(joints))], axis=1)


def loaded(text: str | None, folder: Path) -> object:
    if text is None:
        return None
    path = folder / "hook.py"
    path.write_text(text)
    spec = importlib.util.spec_from_file_location("hook_under_test", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", FORMS)
def test_stock_mujoco_replays_the_emitted_model_as_edream_does(name: str, tmp_path: Path) -> None:
    simulated, values = with_effect(name)
    made = emit(simulated, values)
    (tmp_path / "model.xml").write_text(made.mjcf)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    episode = motion()
    ours = rollout(simulated, simulated.space.vector(values)[None], whole([episode]), threads=1)[0][0]
    hook = loaded(made.hook, tmp_path)
    theirs = stock(model, hook, episode)
    assert np.abs(ours - theirs).max() < 1e-6, f"{name}: {np.abs(ours - theirs).max():.1e} rad"
    np.testing.assert_array_equal(stock(model, hook, episode), theirs, "a step made anew for the same model")
    np.testing.assert_array_equal(stock(model, loaded(made.hook, tmp_path), episode), theirs, "the file loaded anew, too")
    if simulated.has_hooks:
        assert "import edream" not in made.hook and "State" not in made.hook


TERMS = (
    "direction_recent_at_2",
    "speed_recent_at_10",
    "speed_other_at_0",
    "speed_product_at_0",
    "direction_bump_at_0",
    "motor_bump_at_0",
)


@pytest.mark.parametrize("term", TERMS)
def test_a_term_of_a_formula_is_emitted_as_it_was_simulated(term: str, tmp_path: Path) -> None:
    shape = {"centre_0": 0.1, "width_0": 0.2} if "bump" in term else {}
    simulated = SimulatedRobot(ROBOT, (Placement(ResidualTorque([term], [1.0], shape), ("tilt",), fixed=shape),))
    values, windows = {simulated.space.names[0]: -0.2}, whole([motion()])
    made = emit(simulated, values)
    (tmp_path / "model.xml").write_text(made.mjcf)
    ours = rollout(simulated, simulated.space.vector(values)[None], windows, threads=1)[0][0]
    hook = loaded(made.hook, tmp_path)
    alone = stock(mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml")), hook, windows[0].episode)
    emitted = SimulatedRobot(load_robot(tmp_path / "model.xml", site="ee"), ())
    many = rollout(emitted, np.zeros((2, 0)), windows, threads=1, hook=hook.make_batch)[0]
    assert np.abs(ours - alone).max() < 1e-6 and np.abs(ours - many).max() < 1e-6
    assert np.abs(ours - rollout(simulated, np.zeros((1, 1)), windows, threads=1)[0][0]).max() > 1e-4, "it does something"


def test_a_joint_is_remembered_as_fast_as_it_was_lately() -> None:
    simulations = batch.Batch(ROBOT.model, 2, 1)
    simulations.reset()
    simulations.bind("qvel")[:, 0] = (1.5, -1.5)
    state, step, clock = BatchState(simulations), ROBOT.model.opt.timestep, simulations.bind("time")
    for k in range(int(1.0 / step)):
        clock[:] = k * step
        again = state.recent(0, 2.0)
        np.testing.assert_array_equal(state.recent(0, 2.0), again)  # asked twice in a step
    np.testing.assert_allclose(again, 1.5 * (1.0 - np.exp(-0.5)), rtol=1e-6)


def test_a_batch_that_starts_again_remembers_nothing_of_what_it_did_before(tmp_path: Path) -> None:
    simulated = SimulatedRobot(ROBOT, (Placement(ResidualTorque(["direction_recent_at_2"], [1.0], {}), ("tilt",)),))
    made = emit(simulated, {simulated.space.names[0]: -0.2})
    (tmp_path / "model.xml").write_text(made.mjcf)
    simulations = batch.Batch(mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml")), 1, 1)
    step = loaded(made.hook, tmp_path).make_batch(simulations)

    def torques() -> np.ndarray:
        simulations.reset()
        simulations.bind("qvel")[:] = 1.0
        simulations.forward()
        given = []
        for _ in range(50):
            step()
            given.append(simulations.bind("qfrc_applied").copy())
            simulations.step()
        return np.array(given)

    first = torques()
    assert np.abs(first).max() > 0.0
    np.testing.assert_array_equal(torques(), first)


@pytest.mark.parametrize("name", FORMS)
def test_an_emitted_model_loads_again_as_the_same_robot(name: str, tmp_path: Path) -> None:
    simulated, values = with_effect(name)
    made = emit(simulated, values)
    (tmp_path / "model.xml").write_text(made.mjcf)
    again = load_robot(tmp_path / "model.xml", site="ee")
    assert again.joints == ROBOT.joints
    assert emit(simulated, values) == made


def test_the_difference_shows_what_changed_and_nothing_else() -> None:
    simulated = SimulatedRobot(ROBOT, (Placement(catalog.load("effects", "quadratic_drag", Effect), ("tilt",)),))
    difference = emit(simulated, {simulated.space.names[0]: 0.0123456789}).difference
    changed = [line for line in difference.splitlines() if line[:1] in "+-" and line[:3] not in ("+++", "---")]
    assert len(changed) == 2
    assert "0.0123456789" in changed[1] and 'name="tilt"' in changed[1]


def test_mass_may_be_taken_from_where_a_body_has_none() -> None:
    place = Placement(catalog.load("effects", "payload", Effect), ("head",))
    simulated = SimulatedRobot(ROBOT, (place,))
    mass, *axes = place.effect.parameters(ROBOT.model, place.targets)
    values = {place.full_name("mass"): mass.low} | {place.full_name(one.name): one.high for one in axes}
    emitted = mujoco.MjModel.from_xml_string(emit(simulated, values).mjcf)
    body, own = emitted.body("head").id, ROBOT.model.body("head").id
    assert emitted.body_mass[body] == pytest.approx(0.6 * ROBOT.model.body_mass[own])
    a, b, c = np.sort(emitted.body_inertia[body])
    assert a > 0.0 and a + b >= c * (1.0 - 1e-9)


def test_a_step_made_anew_for_a_batch_knows_its_own_friction(tmp_path: Path) -> None:
    simulated, values = with_effect("load_friction")
    made = emit(simulated, values)
    (tmp_path / "model.xml").write_text(made.mjcf)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    many = batch.Batch(model, 2, 1)
    step = loaded(made.hook, tmp_path).make_batch(many)
    for _ in range(20):
        step()
        many.step()
    step()
    written = many.expand("dof_frictionloss").copy()
    assert (written > model.dof_frictionloss).any(), "the load has added to it"
    loaded(made.hook, tmp_path).make_batch(many)()
    np.testing.assert_array_equal(many.expand("dof_frictionloss"), written)
