"""Hidden effects: each one there when it is there, and not there to the last bit when it is absent."""

import ast
import json
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import edream
from edream.core.errors import EdreamError
from edream.reality.effects import KINDS
from edream.reality.motions import commands
from edream.reality.plant import nominal_plant
from edream.reality.recorder import Recorder, make_recordings
from edream.reality.truth import Hidden, Truth, absent, draw, joint_range, seal, unseal
from edream.record import RecordConfig, record, truth_path
from edream.sim.robot import load_robot

PACKAGE = Path(edream.__file__).parent
PAN_TILT = load_robot(PACKAGE / "robots" / "pan_tilt.xml", site="ee")
ARM6 = load_robot(PACKAGE / "robots" / "arm6.xml", site="ee")
EXACT = Recorder(noise=0.0, jitter=0.0, counts=10**9, step=0.001, settle=0.3)
BASE = draw(PAN_TILT, [], np.random.default_rng(11))


def positions(truth: Truth, recorder: Recorder = EXACT) -> np.ndarray:
    return np.stack([one.position for one in make_recordings(PAN_TILT, truth, 5, 18, 1.2, recorder)])


@pytest.fixture(scope="module")
def without() -> np.ndarray:
    return positions(BASE)


@pytest.mark.parametrize("name", KINDS)
def test_each_effect_shows_when_it_is_there(name: str, without: np.ndarray) -> None:
    truth = replace(
        draw(PAN_TILT, [name], np.random.default_rng(2), at=["head" if name == "payload" else "tilt"]), nuisance=BASE.nuisance
    )
    there = positions(truth)
    assert np.isfinite(there).all()
    shift = np.sqrt(np.mean((there - without) ** 2, axis=(0, 1))).max()
    assert 0.0003 < shift < 0.3


def test_effects_at_their_absent_values_change_not_a_bit(without: np.ndarray) -> None:
    truth = replace(draw(PAN_TILT, list(KINDS), np.random.default_rng(3)), nuisance=BASE.nuisance)
    assert len(truth.effects) == len(KINDS) > 35
    assert (positions(absent(truth)) == without).all()


def test_the_same_seed_gives_the_same_recordings_and_another_seed_others() -> None:
    noisy = Recorder(step=0.001)
    first, again, other = (make_recordings(PAN_TILT, BASE, seed, 2, 1.0, noisy) for seed in (1, 1, 2))
    for a, b in zip(first, again, strict=True):
        assert (a.position == b.position).all() and (a.times == b.times).all() and (a.command == b.command).all()
    assert not (first[0].command == other[0].command).all()


def test_the_truth_does_not_change_what_is_commanded() -> None:
    hidden = draw(PAN_TILT, ["payload"], np.random.default_rng(0))
    one, two = (make_recordings(PAN_TILT, truth, 4, 1, 1.0, EXACT)[0] for truth in (BASE, hidden))
    assert (one.command == two.command).all()


@pytest.mark.parametrize("robot", [ARM6, PAN_TILT], ids=lambda robot: robot.name)
def test_commands_stay_clear_of_the_joint_limits_and_move_every_joint(robot) -> None:
    rows = commands(robot.model, np.random.default_rng(0), 12, 10.0, 50.0)
    low, high = joint_range(robot.model)
    assert rows.shape == (12, 500, len(robot.joints))
    assert (rows > low + 0.05 * (high - low)).all() and (rows < high - 0.05 * (high - low)).all()
    assert (np.ptp(rows, axis=(0, 1)) > 0.3 * (high - low)).all()


def test_a_joint_that_hardly_turns_is_moved_within_its_room() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="a" range="-2 2"/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    low, high = joint_range(model)
    rows = commands(model, np.random.default_rng(0), 2, 3.0, 50.0)
    assert (rows > low).all() and (rows < high).all() and np.ptp(rows) > 0.1 * (high - low)


def test_recordings_show_encoder_steps_noise_and_a_rising_jittery_clock() -> None:
    recorder = Recorder(counts=4096, step=0.001)
    one = make_recordings(PAN_TILT, BASE, 0, 1, 2.0, recorder)[0]
    count = 2.0 * np.pi / 4096
    np.testing.assert_allclose(one.position / count, np.round(one.position / count), atol=1e-6)
    assert (np.diff(one.times) > 0).all() and one.times[0] == 0.0
    assert 1e-4 < np.std(np.diff(one.times)) < 1e-3


def test_drawn_nuisance_parameters_are_off_by_at_most_the_deviation() -> None:
    truth = draw(ARM6, [], np.random.default_rng(0), deviation=0.3)
    model = ARM6.model
    factors = np.array([truth.nuisance["kp"][j] for j in ARM6.joints]) / model.actuator_gainprm[:, 0]
    assert (np.abs(np.log(factors)) <= np.log(1.3)).all() and np.std(factors) > 0.05


def test_pairs_act_together() -> None:
    pair = draw(PAN_TILT, ["payload", "actuator_delay"], np.random.default_rng(0), at=["head", "tilt"])
    single = Truth(pair.robot, pair.effects[:1], pair.nuisance)
    assert [h.name for h in pair.effects] == ["payload", "actuator_delay"]
    assert not (positions(pair) == positions(single)).all()


@dataclass(frozen=True)
class Newer(Truth):
    """A truth of times to come."""

    warmth: float = 1.0


def test_a_sealed_truth_of_a_newer_edream_is_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "data.truth.json"
    seal(Newer("pan_tilt"), path)
    with pytest.raises(EdreamError, match=r"data\.truth\.json holds warmth, which this edream does not know"):
        unseal(path)


def test_a_sealed_truth_opens_again_hides_its_words_and_tells_if_it_was_altered(tmp_path: Path) -> None:
    truth = replace(draw(PAN_TILT, ["payload"], np.random.default_rng(0)), smooth=0.01)
    path = tmp_path / "data.truth.json"
    seal(truth, path)
    assert unseal(path) == truth
    text = path.read_text(encoding="utf-8")
    assert "payload" not in text and "head" not in text
    broken = json.loads(text) | {"digest": "0" * 64}
    path.write_text(json.dumps(broken), encoding="utf-8")
    with pytest.raises(EdreamError, match="altered"):
        unseal(path)
    with pytest.raises(EdreamError, match="already"):
        seal(truth, path)


def test_record_writes_a_data_set_and_keeps_the_truth_beside_it(tmp_path: Path) -> None:
    config = RecordConfig(out=tmp_path / "data", effects=("payload",), motions=2, seconds=1.0, step=0.001)
    summary = record(PAN_TILT, config, seed=1)
    assert summary["recordings"] == 2 and "payload" not in json.dumps(summary)
    assert unseal(truth_path(config.out)).effects[0].name == "payload"
    assert not [path for path in config.out.rglob("*") if "truth" in path.name]
    with pytest.raises(EdreamError, match="already something"):
        record(PAN_TILT, config, seed=1)


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (Hidden("payloat", ("head",), {}), "Did you mean 'payload'"),
        (Hidden("coulomb", ("tild",), {"torque": 0.1}), "Did you mean 'tilt'"),
        (Hidden("coulomb", ("tilt",), {"force": 0.1}), "needs the values"),
    ],
)
def test_a_wrong_truth_is_refused_in_words(effect: Hidden, message: str) -> None:
    with pytest.raises(EdreamError, match=message):
        Truth("pan_tilt", (effect,)).terms(PAN_TILT.model)


def imports(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def test_the_make_believe_robot_shares_nothing_with_what_is_tested_on_it() -> None:
    allowed = ("edream.core", "edream.reality", "edream.sim.robot")
    for path in (PACKAGE / "reality").glob("*.py"):
        for name in imports(path):
            assert not name.startswith("edream.") or name.startswith(allowed), f"{path.name} imports {name}"


def test_nothing_that_diagnoses_sees_the_truth() -> None:
    may = {"record.py", "record_task.py", "evaluate.py", "gym.py"}
    for path in PACKAGE.rglob("*.py"):
        if path.parent.name == "reality" or path.name in may or path.name.startswith("cli"):
            continue
        assert not any(name.startswith("edream.reality") for name in imports(path)), f"{path} imports edream.reality"
        assert "truth.json" not in path.read_text(encoding="utf-8") and "unseal" not in path.read_text(encoding="utf-8"), path


@pytest.mark.parametrize("name", ["servo_gain", "viscous", "coulomb", "armature"])
def test_a_hidden_change_of_a_usual_number_is_more_than_that_number_may_be_off_by(name: str) -> None:
    for seed in range(20):
        truth = draw(ARM6, [name], np.random.default_rng(seed), deviation=0.3)
        (joint,) = truth.effects[0].targets
        (value,) = truth.effects[0].values.values()
        nominal = nominal_plant(ARM6.model)
        column = nominal.joints.index(joint)
        for number in KINDS[name].changes:
            assert truth.nuisance[number][joint] == pytest.approx(getattr(nominal, number)[column])
        usual = sum(float(getattr(nominal, number)[column]) for number in KINDS[name].changes)
        change = value if name == "servo_gain" else 1.0 + value / usual
        assert change < 0.68 or change > 1.35
