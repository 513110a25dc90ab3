"""What a further effect is measured against."""

from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import forward, trials
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.trials import Trial
from tests.still_problem import trial_of


@pytest.mark.parametrize(("at_the_end", "counted"), [((1.0, 9.0), (2.0, 2.0)), ((1.0, 1.0), (1.0, 1.0))])
def test_a_further_effect_is_measured_against_the_best_that_a_model_is_known_to_predict(
    monkeypatch: pytest.MonkeyPatch, at_the_end: tuple[float, float], counted: tuple[float, float]
) -> None:
    """A tilt was named beside friction with the load that mended one motion, which only the end of that search had spoiled."""
    monkeypatch.setattr(trials, "left_out_errors", lambda problem, fit: np.array(at_the_end))
    taken = Trial(Candidate("load_friction", ("lift",)), 0.1, SimpleNamespace(), np.full(2, 2.0), 0.8, True)  # type: ignore[arg-type]
    errors = trials.predicted(SimpleNamespace(), SimpleNamespace(), taken)  # type: ignore[arg-type]
    np.testing.assert_array_equal(errors, counted)
    np.testing.assert_array_equal(trials.predicted(SimpleNamespace(), SimpleNamespace(), None), at_the_end)  # type: ignore[arg-type]


def test_a_round_begins_anew_where_the_fit_left_a_false_valley(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is taken of what only gained by leaving it, and what is in the fit is measured from there."""
    far, near, looked = SimpleNamespace(rms=9.0), SimpleNamespace(rms=1.0), list[object]()
    told = {
        "with_short_steps": lambda problem, fit: (problem, fit),
        "predicted": lambda problem, fit, taken: np.full(2, fit.rms),
        "untouched": lambda problem, taken: frozenset(),
        "asks_for_more": lambda problem, fit, first, errors, bare: fit is far,
        "screen_twice": lambda problem, fit, done: looked.append(fit) or [],
        "try_best": lambda problem, fit, errors, scored, done: [trial_of("spring", 0.3)],
        "nearer_without": lambda fit, trials: near,
    }
    for name, stand_in in told.items():
        monkeypatch.setattr(forward, name, stand_in)
    problem = SimpleNamespace(settings=SimpleNamespace(most=4))
    _, fit, rounds = forward.forward(problem, far)  # type: ignore[arg-type]
    assert (fit, looked) == (near, [far])
    assert [(one.before, one.taken) for one in rounds] == [(near, None)]
    np.testing.assert_array_equal(rounds[0].errors, [1.0, 1.0])
