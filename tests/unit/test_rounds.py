"""What a further effect is measured against."""

from types import SimpleNamespace

import numpy as np
import pytest

from edream.diagnosis import trials
from edream.diagnosis.candidates import Candidate
from edream.diagnosis.trials import Trial


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
