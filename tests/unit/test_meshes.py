"""Robots as they are published: split over files that include each other, with meshes in a folder, seen and touched."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from edream import catalog
from edream.core.effect import Effect
from edream.core.episode import Episode
from edream.core.errors import EdreamError
from edream.diagnosis.candidates import loose_geoms
from edream.sim.emit import emit
from edream.sim.lean import lean_spec
from edream.sim.robot import RobotModel, load_robot
from edream.sim.rollout import rollout
from edream.sim.simulation import Placement, SimulatedRobot
from edream.sim.touch import kept_clear, never_touches
from edream.sim.window import whole

TETRAHEDRON = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.4\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
SCENE = "<mujoco><include file='parts/arm.xml'/><worldbody>{table}</worldbody></mujoco>"
ARM = """<mujoco model='arm'>
  <compiler meshdir='meshes' autolimits='true'/>
  <default><default class='seen'><geom contype='0' conaffinity='0' material='grey'/></default></default>
  <asset><mesh name='link' file='link.obj'/><mesh name='shell' file='shell.obj'/>
    <material name='grey' rgba='0.5 0.5 0.5 1'/></asset>
  <worldbody>
    <body name='upper' pos='0 0 0.5'><joint name='shoulder' axis='0 1 0'/>
      <geom class='seen' type='mesh' mesh='shell' mass='0.3'/><geom name='bone' type='mesh' mesh='link' mass='1'/>
      <body name='lower' pos='0 0 0.4'><joint name='elbow' axis='0 1 0'/><geom class='seen' type='mesh' mesh='shell' mass='0.2'/>
        <inertial pos='0 0 0.1' mass='0.5' fullinertia='0.01 0.01 0.002 0 0.001 0'/><site name='ee' pos='0 0 0.3'/></body></body>
  </worldbody>
  <actuator><position name='a' joint='shoulder' kp='60' kv='3'/><position name='b' joint='elbow' kp='20' kv='1'/></actuator>
</mujoco>"""
TABLE = "<geom name='table' type='plane' size='2 2 0.1' pos='0 0 {height}'/>"


def written(folder: Path, table: str = "") -> Path:
    (folder / "parts").mkdir(parents=True)
    (folder / "meshes").mkdir()
    (folder / "parts" / "arm.xml").write_text(ARM)
    for name in ("link", "shell"):
        (folder / "meshes" / f"{name}.obj").write_text(TETRAHEDRON)
    path = folder / "scene.xml"
    path.write_text(SCENE.format(table=table))
    return path


def swinging(robot: RobotModel) -> Episode:
    times = np.arange(0.0, 2.0, 0.02)
    command = np.stack([0.6 * np.sin(2.0 * times), 0.8 * np.sin(3.0 * times)], axis=1)
    return Episode("swing", robot.joints, times, 0.9 * command, times, command)


def rubbing(robot: RobotModel) -> SimulatedRobot:
    return SimulatedRobot(robot, (Placement(catalog.load("effects", "coulomb", Effect), robot.joints),))


def test_a_model_split_over_files_is_the_model_that_mujoco_reads(tmp_path: Path) -> None:
    path = written(tmp_path, TABLE.format(height=0))
    robot, stock = load_robot(path), mujoco.MjModel.from_xml_path(str(path))
    assert robot.joints == ("shoulder", "elbow")
    assert set(robot.assets) == {"meshes/link.obj", "meshes/shell.obj"}
    for name in ("body_mass", "body_inertia", "body_ipos", "geom_contype", "geom_pos", "actuator_gainprm", "actuator_biasprm"):
        np.testing.assert_allclose(getattr(robot.model, name), getattr(stock, name), rtol=1e-5, atol=1e-7, err_msg=name)


def test_an_include_that_is_no_xml_is_told(tmp_path: Path) -> None:
    path = written(tmp_path)
    (tmp_path / "parts" / "arm.xml").write_text(ARM.replace("<body name='upper'", "<bodi name='upper'"))
    with pytest.raises(EdreamError, match=r"arm\.xml is not XML: mismatched tag"):
        load_robot(path)


@pytest.mark.parametrize(
    ("main", "said"),
    [
        ("<mujoco><include file='../arm.xml'/></mujoco>", "outside its own folder"),
        ("<mujoco><include file='none.xml'/></mujoco>", "does not exist"),
        ("<mujoco><include/></mujoco>", "names no file"),
        ("<mujoco><include file='parts/arm.xml'/><include file='parts/arm.xml'/></mujoco>", "twice"),
        ("<mujoco><include file='scene.xml'/></mujoco>", "twice"),
    ],
)
def test_an_include_that_cannot_be_followed_is_told(tmp_path: Path, main: str, said: str) -> None:
    path = written(tmp_path / "robot")
    (tmp_path / "arm.xml").write_text(ARM)
    path.write_text(main)
    with pytest.raises(EdreamError, match=said):
        load_robot(path)


def test_what_is_written_loads_in_mujoco_with_the_meshes_beside_it(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path / "published"))
    simulated = rubbing(robot)
    made = emit(simulated, simulated.space.start())
    out = tmp_path / "emitted"
    for name, data in made.files.items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(data)
    (out / "model.xml").write_text(made.mjcf)
    stock = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    assert stock.nmesh == 2 and stock.ngeom == robot.model.ngeom
    np.testing.assert_allclose(stock.body_inertia, robot.model.body_inertia, rtol=1e-12)
    assert load_robot(out / "model.xml").joints == robot.joints


def test_a_mesh_named_by_a_roundabout_way_lies_where_that_leads(tmp_path: Path) -> None:
    path = written(tmp_path / "published")
    arm = tmp_path / "published" / "parts" / "arm.xml"
    arm.write_text(ARM.replace("file='shell.obj'", "file='../meshes/shell.obj'"))
    simulated = rubbing(load_robot(path))
    assert set(emit(simulated, simulated.space.start()).files) == {"meshes/link.obj", "meshes/shell.obj"}


def test_a_geom_that_an_effect_acts_on_stays_though_it_only_shows(tmp_path: Path) -> None:
    label = "<geom name='label' size='0.01' contype='0' conaffinity='0' mass='0.01'/>"
    cup = f"<body name='cup' pos='3 0 1'><freejoint/><geom name='cup' size='0.05' mass='0.1'/>{label}</body>"
    robot = load_robot(written(tmp_path, cup))
    assert loose_geoms(robot.model) == ["cup"]
    placed = SimulatedRobot(robot, (Placement(catalog.load("effects", "contact_friction", Effect), ("label",)),))
    assert placed.swift.model.ngeom == 3 and SimulatedRobot(robot, ()).swift.model.ngeom == 2


@pytest.mark.parametrize("clear", [False, True])
def test_a_lean_robot_weighs_what_the_whole_one_does(tmp_path: Path, clear: bool) -> None:
    robot = replace(load_robot(written(tmp_path, TABLE.format(height=0))), clear=clear)
    model, lean = robot.model, lean_spec(robot).compile()
    assert lean.ngeom == (0 if clear else 2) and lean.nmesh == (0 if clear else 1)
    for name in ("body_mass", "body_ipos", "body_iquat", "body_inertia", "body_invweight0", "dof_invweight0", "site_pos"):
        np.testing.assert_array_equal(getattr(lean, name), getattr(model, name), err_msg=name)


def test_a_search_sees_the_motion_of_the_whole_model(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, TABLE.format(height=-1)))
    episode = swinging(robot)
    whole_one = rubbing(kept_clear(robot, [episode]))
    values, windows = whole_one.space.start()[None], whole([episode])
    assert whole_one.robot.clear and whole_one.swift.model.ngeom == 0 and whole_one.model.ngeom == robot.model.ngeom
    seen, told = (rollout(one, values, windows, threads=1)[0] for one in (whole_one.swift, whole_one))
    assert np.ptp(told) > 0.5
    np.testing.assert_allclose(seen, told, rtol=0.0, atol=1e-6)


def test_a_robot_that_touches_its_table_keeps_its_contacts(tmp_path: Path) -> None:
    robot = load_robot(written(tmp_path, TABLE.format(height=0.51)))
    episode = swinging(robot)
    assert not never_touches(robot, [episode])
    assert rubbing(kept_clear(robot, [episode])).swift.model.ngeom == 2


@pytest.mark.parametrize(("height", "lone"), [(0.0999, True), (0.097, False)])
def test_what_is_always_near_is_a_neighbour_and_what_comes_near_may_touch(tmp_path: Path, height: float, lone: bool) -> None:
    neighbour = "<geom name='foot' size='0.05' pos='0 0 {at}'/>"  # beside the ball of the upper link, which turns on the spot
    ball = "<mujoco><worldbody>{foot}<body pos='0 0 0.2'><joint name='turn' axis='0 1 0'/><geom size='0.05' mass='1'/>{arm}</body>"
    drive = "</worldbody><actuator><position joint='turn' kp='10' kv='1'/></actuator></mujoco>"
    arm = "" if lone else "<geom type='capsule' fromto='0 0 0 0 0 -0.046' size='0.05'/>"
    path = tmp_path / "ball.xml"
    path.write_text((ball + drive).format(foot=neighbour.format(at=height if lone else 0.0999 - 0.048), arm=arm))
    robot = load_robot(path)
    times = np.arange(0.0, 2.0, 0.02)
    turned = np.sin(times)[:, None]
    assert never_touches(robot, [Episode("turning", ("turn",), times, turned, times, turned)]) == lone


def test_a_free_object_is_never_left_out(tmp_path: Path) -> None:
    cup = "<body name='cup' pos='3 0 1'><freejoint/><geom name='cup' size='0.05' mass='0.1'/></body>"
    robot = load_robot(written(tmp_path, cup))
    assert not never_touches(robot, [swinging(robot)])
