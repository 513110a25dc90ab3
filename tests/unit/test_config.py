from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, Literal

import pytest
from omegaconf import OmegaConf

from edream import config, pipeline
from edream.core.errors import EdreamError
from edream.record import RecordConfig
from edream.stages.fit import FitConfig
from edream.stages.sweep import SweepConfig


@dataclass(frozen=True)
class Inner:
    rate: float
    kind: Literal["adam", "sgd"] = "adam"


@dataclass(frozen=True)
class Settings:
    steps: int
    inner: Inner
    model: Path | None = None
    names: tuple[str, ...] = ()
    box: tuple[float, float] = (0.0, 1.0)
    limits: Mapping[str, float] = field(default_factory=dict)


GOOD = {"steps": 3, "inner": {"rate": 1}, "names": ["a", "b"], "box": [1, 2.5], "limits": {"x": 2}, "model": "m.xml", "unread": 1}


def test_a_config_becomes_a_frozen_dataclass_with_the_right_types() -> None:
    read = config.read(OmegaConf.create(GOOD), Settings)
    assert read == Settings(3, Inner(1.0), Path("m.xml"), ("a", "b"), (1.0, 2.5), {"x": 2.0})
    assert type(read.inner.rate) is float


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"steps": "many"}, "steps is 'many'; expected an integer"),
        ({"steps": 2.5}, "steps is 2.5; expected an integer"),
        ({"steps": True}, "steps is True; expected an integer"),
        ({"steps": "???"}, "'steps' is not set"),
        ({"inner": {"rate": "fast"}}, "inner.rate is 'fast'; expected a number"),
        ({"inner": {"rate": 1, "kind": "adm"}}, "Did you mean 'adam'"),
        ({"inner": 3}, "expected a group"),
        ({"names": "a"}, "expected a list"),
        ({"names": [1]}, r"names\[0\] is 1; expected text"),
        ({"box": [1]}, "box has 1 values; expected 2"),
        ({"limits": {"x": "y"}}, "limits.x is 'y'"),
        ({"inner": {"rate": float("inf")}}, "finite"),
        ({"model": 7}, "model is 7; expected a path"),
    ],
)
def test_a_wrong_value_is_one_sentence_that_names_it(change, sentence) -> None:
    with pytest.raises(EdreamError, match=sentence):
        config.read(OmegaConf.create({**GOOD, **change}), Settings)


def test_the_shipped_config_composes_for_every_robot() -> None:
    for robot in (config.conf_folder() / "robot").glob("*.yaml"):
        config.compose([f"robot={robot.stem}"])


def test_a_path_may_hold_spaces_commas_quotes_and_equals_signs() -> None:
    path = "/data/it's, a=b (c)/x y"
    assert config.compose([f"data={path}"]).data == path


def test_small_numbers_are_numbers() -> None:
    assert config.compose(["ingest.fps=1e-3"]).ingest.fps == 1e-3


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("robto=so101", "Did you mean 'robot'"),
        ("robot=so10", "Did you mean 'so101'"),
        ("ingest.strct=true", "setting in ingest: 'strct'. Did you mean 'strict'"),
        ("ingest.mapping.unitt=deg", "setting in ingest.mapping: 'unitt'. Did you mean 'unit'"),
        ("ingst.strict=true", "Did you mean 'ingest'"),
        ("data", "Expected NAME=VALUE"),
        ("=3", "Expected NAME=VALUE"),
        ("ingest.fps=[1", "Expected NAME=VALUE"),
    ],
)
def test_a_mistyped_override_is_one_sentence_with_the_nearest_name(override, sentence) -> None:
    with pytest.raises(EdreamError, match=sentence):
        config.compose([override])


def test_a_folder_of_ones_own_adds_choices_and_its_misspelt_keys_are_refused(tmp_path) -> None:
    from edream import pipeline

    (tmp_path / "robot").mkdir()
    (tmp_path / "robot" / "mine.yaml").write_text("defaults: [custom]\nname: mine\nmjcf: m.xml\n")
    good = config.compose(["robot=mine"], tmp_path)
    assert good.robot.name == "mine"
    pipeline.check_settings(good)
    (tmp_path / "robot" / "mine.yaml").write_text("defaults: [custom]\nnmae: mine\n")
    with pytest.raises(EdreamError, match=r"'nmae'\. Did you mean 'name'"):
        pipeline.check_settings(config.compose(["robot=mine"], tmp_path))


@pytest.mark.parametrize(
    "override",
    [
        "fit.seconds=0",
        "fit.stretch=-1",
        "fit.rate=0",
        "fit.until=0",
        "fit.limits={coulomb.torque: {lo: 1}}",
        "fit.limits={coulomb.torque: {spread: -1}}",
        "fit.scaled={servo_gain.kp: {condition: gain, reference: 0}}",
        "fit.search.iterations=0",
        "sweep.sets=100",
        "sweep.blocks=0",
        "sweep.seconds=0",
        "seed=-1",
        "record.noise=-1",
        "record.smooth=-0.01",
    ],
)
def test_a_setting_out_of_its_range_is_one_sentence_that_names_it(override: str) -> None:
    cfg = config.compose(["robot=pan_tilt", "data=recordings", "record.out=made", override])
    part = override.split(".")[0].split("=")[0]
    kind = {"fit": FitConfig, "sweep": SweepConfig, "seed": FitConfig}.get(part)
    with pytest.raises(EdreamError) as told:
        config.read(cfg, kind) if kind else config.read(cfg.record, RecordConfig, "record")
    assert "expected" in str(told.value) or "What exists" in str(told.value)
    assert "\n" not in str(told.value)


def test_settings_with_names_of_ones_own_can_be_given_on_the_command_line() -> None:
    cfg = config.compose(["fit.fixed={servo_gain.kp: 18}", "surrogate.options.hidden=16", "ingest.mapping.units.elbow=deg"])
    assert dict(cfg.fit.fixed) == {"servo_gain.kp": 18}
    assert dict(cfg.surrogate.options) == {"hidden": 16}
    assert dict(cfg.ingest.mapping.units) == {"elbow": "deg"}


def differing(settings: Any, place: str) -> Iterator[str]:
    """Numbers, words and switches whose default in code is not what conf/ says."""
    for one in fields(settings):
        value, where = getattr(settings, one.name), f"{place}.{one.name}" if place else one.name
        default = one.default_factory() if one.default_factory is not MISSING else one.default
        if is_dataclass(value):
            yield from differing(value, where)
        elif default not in (MISSING, None, (), {}) and default != value:
            yield where


@pytest.mark.parametrize(
    "stage", ["condition", "diagnose", "dream", "evaluate", "masks", "rank", "render", "rl", "rollouts", "score", "sweep"]
)
def test_a_default_in_code_is_the_one_in_conf(stage: str) -> None:
    cfg = config.compose(["robot=arm6_working", "task=grab_paper_cup", "data=recordings"])
    shared = (".train.", "rollouts.noise.")  # one schedule serves several trainings, and zeros mean that nothing is left to chance
    found = differing(config.read(cfg, pipeline.stage(stage).config), "")
    assert [where for where in found if not any(part in where for part in shared)] == []
