"""What hidden robots are like lies within what a diagnosis searches: an effect outside its box could not be found."""

import numpy as np
import pytest

from benchmarks.blind.cases import SITES, robot_of
from benchmarks.blind.names import library_name, true_targets, true_values
from edream.catalog import load
from edream.core.effect import Effect
from edream.reality.effects import KINDS
from edream.reality.truth import draw

DRAWS = 20


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if not kind.foreign])
@pytest.mark.parametrize("robot_name", SITES)
def test_hidden_values_lie_within_the_searched_box(robot_name: str, name: str) -> None:
    if (robot := robot_of(robot_name)) is None:
        pytest.skip("the model of this robot comes with the measurements, which are not here; set EDREAM_SHARED_DATA")
    effect = load("effects", library_name(name), Effect)
    outside = []
    for seed in range(DRAWS):
        truth = draw(robot, (name,), np.random.default_rng(seed))
        targets = tuple(true_targets(truth.effects[0], robot.model))
        parameters = effect.parameters(robot.model, targets)
        more = {p.name: 1e-9 if p.attained else 0.0 for p in parameters}
        boxes = {p.name: (p.low - more[p.name], p.high + more[p.name]) for p in parameters}
        values = true_values(truth.effects[0], truth, robot.model)
        outside += [(targets, q, v, boxes[q]) for q, v in values.items() if q in boxes and not boxes[q][0] < v < boxes[q][1]]
    assert outside == []
