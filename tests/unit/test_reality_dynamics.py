"""The make-believe robot's physics: right against MuJoCo where both say the same, and against first principles elsewhere."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

import edream
from edream.core.errors import EdreamError
from edream.reality.dynamics import tree_of
from edream.reality.integrator import move, slide
from edream.reality.plant import nominal_plant
from edream.reality.recorder import Recorder, make_recordings
from edream.reality.truth import Truth
from edream.sim.robot import RobotModel, load_robot

FOLDER = Path(edream.__file__).parent / "robots"
ARM6 = load_robot(FOLDER / "arm6.xml", site="ee")

ODD = """<mujoco><compiler angle="radian"/><worldbody><body pos="0.1 0 0" euler="0.3 0.2 0.1">
  <joint name="a" axis="1 2 0" pos="0.02 0 0.1"/><joint name="b" type="slide" axis="0 1 1" pos="0 0.1 0"/>
  <inertial pos="0.1 0.2 0" mass="1.1" fullinertia="0.02 0.03 0.025 0.001 0.002 -0.001"/>
  <body pos="0 0.3 0" quat="0.5 -0.5 0.5 0.5"><inertial pos="0 0 0.1" mass="0.4" diaginertia="0.01 0.01 0.01"/>
    <body pos="0.1 0 0"><joint name="c" axis="0 0 1"/><geom size="0.1" pos="0.1 0 0"/></body>
    <body pos="-0.1 0 0"><joint name="d" axis="0 1 0" ref="0.4"/><geom size="0.08" pos="0 0 0.2"/></body>
  </body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("name", ["arm6", "cobot", "pan_tilt", "odd"])
def test_mass_matrix_and_bias_are_those_of_mujoco(name: str) -> None:
    model = mujoco.MjModel.from_xml_string(ODD) if name == "odd" else load_robot(FOLDER / f"{name}.xml").model
    rng = np.random.default_rng(0)
    q, v, a = (rng.normal(size=(6, model.nv)) for _ in range(3))
    mass, bias = tree_of(model).terms(q, v, model.opt.gravity)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.dof_armature[:], model.dof_damping[:] = 0.0, 0.0
    data = mujoco.MjData(model)
    for motion in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[motion], v[motion], a[motion]
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(mass[motion] @ a[motion] + bias[motion], data.qfrc_inverse, rtol=0, atol=1e-8)


def test_a_payload_is_a_point_mass_on_its_body() -> None:
    plain, loaded = ARM6.model, tree_of(ARM6.model).with_mass(ARM6.model.body("hand").id, 0.7, np.array([0.05, 0.01, -0.02]))
    q = np.full((1, plain.nv), 0.3)
    _, bias = loaded.terms(q, 0 * q, plain.opt.gravity)
    _, without = tree_of(plain).terms(q, 0 * q, plain.opt.gravity)
    data = mujoco.MjData(plain)
    data.qpos[:] = q[0]
    mujoco.mj_forward(plain, data)
    point = data.body("hand").xpos + data.body("hand").xmat.reshape(3, 3) @ [0.05, 0.01, -0.02]
    jacobian = np.zeros((3, plain.nv))
    mujoco.mj_jac(plain, data, jacobian, None, point, plain.body("hand").id)
    np.testing.assert_allclose((bias - without)[0], jacobian[2] * 0.7 * 9.81, atol=1e-12)


def test_a_free_swing_keeps_its_energy() -> None:
    model = ARM6.model
    quiet = {name: np.zeros(model.nv) for name in ("kp", "kd", "damping", "frictionloss")}
    plant = nominal_plant(model).with_values(**quiet)
    start = np.tile(model.jnt_range.mean(axis=1), (2, 1))
    start[:, -1] = 0.0
    plant = plant.with_values(armature=plant.armature + np.array([0, 0, 0, 0, 0, 0, 1e6]))
    track = move(plant, (), start, np.tile(start, (1500, 1, 1)), 0.0005)
    energy = []
    data = mujoco.MjData(model)
    for row in range(0, 1501, 100):
        q, v = track.link[row, 0], track.velocity[row, 0]
        mass, _ = plant.tree.terms(q[None], v[None], plant.gravity)
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        height = float(model.body_mass @ data.xipos[:, 2])
        energy.append(0.5 * v @ (mass[0] + np.diag(plant.armature)) @ v + 9.81 * height)
    assert np.abs(track.velocity).max() > 1.0
    assert np.ptp(energy) < 2e-3


def test_dry_friction_holds_on_a_slope_below_its_limit_and_gives_above() -> None:
    model = load_robot(FOLDER / "pan_tilt.xml").model
    nominal = nominal_plant(model).with_values(kp=np.zeros(2), kd=np.zeros(2))
    start = np.array([[0.0, 0.2]])
    _, bias = nominal.tree.terms(start, np.zeros((1, 2)), nominal.gravity)
    need = abs(float(bias[0, 1]))
    for factor, holds in ((1.01, True), (0.95, False)):
        plant = nominal.with_values(frictionloss=np.array([0.1, factor * need]))
        track = move(plant, (), start, np.tile(start, (800, 1, 1)), 0.0005)
        assert (np.ptp(track.link[:, 0, 1]) == 0.0) == holds


def test_smooth_dry_friction_creeps_on_a_slope_as_fast_as_its_law_says() -> None:
    model = load_robot(FOLDER / "pan_tilt.xml").model
    nominal = nominal_plant(model).with_values(kp=np.zeros(2), kd=np.zeros(2), damping=np.zeros(2), smooth=0.004)
    start = np.array([[0.0, 0.2]])
    _, bias = nominal.tree.terms(start, np.zeros((1, 2)), nominal.gravity)
    plant = nominal.with_values(frictionloss=np.array([0.1, 2.0 * abs(float(bias[0, 1]))]))
    track = move(plant, (), start, np.tile(start, (400, 1, 1)), 0.0005)
    assert track.velocity[-1, 0, 1] == pytest.approx(-np.sign(bias[0, 1]) * 0.004 * np.arctanh(0.5), rel=0.02)
    assert abs(track.velocity[-1, 0, 0]) < 1e-6


def test_the_friction_solve_meets_its_law() -> None:
    rng = np.random.default_rng(3)
    root = rng.normal(size=(40, 5, 5))
    matrix = root @ root.swapaxes(1, 2) + 0.5 * np.eye(5)
    goal, up, down = rng.normal(size=(40, 5)) * 2, rng.uniform(0, 1.5, (40, 5)), rng.uniform(0, 1.5, (40, 5))
    v, _, p = slide(matrix, goal, up, down, np.zeros((40, 5), dtype=int))
    np.testing.assert_allclose((matrix @ v[..., None])[..., 0] + p, goal, atol=1e-10)
    assert (p <= up + 1e-9).all() and (p >= -down - 1e-9).all()
    assert (np.where(v > 1e-9, np.abs(p - up), 0) < 1e-9).all() and (np.where(v < -1e-9, np.abs(p + down), 0) < 1e-9).all()


def test_without_dry_friction_it_moves_as_mujoco_does() -> None:
    smooth = Truth("arm6", (), {"frictionloss": dict.fromkeys(ARM6.joints, 0.0)})
    exact = Recorder(noise=0.0, jitter=0.0, counts=10**9)
    recording = make_recordings(ARM6, smooth, 3, 2, 2.0, exact)[1]
    model = ARM6.spec().compile()
    model.dof_frictionloss[:] = 0.0
    model.opt.timestep = 0.0005
    data = mujoco.MjData(model)
    data.qpos[:] = data.ctrl[:] = recording.command[0]
    mujoco.mj_step(model, data, 2000)
    for row in range(len(recording.times)):
        assert np.abs(data.qpos - recording.position[row]).max() < 1e-3
        data.ctrl[:] = recording.command[row]
        mujoco.mj_step(model, data, 40)


def test_halving_the_step_changes_almost_nothing() -> None:
    truth = Truth("pan_tilt")
    robot = RobotModel("pan_tilt", (FOLDER / "pan_tilt.xml").read_text(encoding="utf-8"))
    coarse, fine = (
        np.stack(
            [r.position for r in make_recordings(robot, truth, 1, 3, 1.5, Recorder(noise=0, jitter=0, counts=10**9, step=step))]
        )
        for step in (0.0005, 0.00025)
    )
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 5e-5


def test_a_robot_it_cannot_be_is_refused_in_words() -> None:
    ball = mujoco.MjModel.from_xml_string('<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>')
    with pytest.raises(EdreamError, match="hinge and slide"):
        tree_of(ball)
