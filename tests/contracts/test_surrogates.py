"""What every surrogate must do, run on each entry of the catalog without being told."""

import numpy as np
import pytest
import torch

from edream import catalog
from edream.calibration.surrogate import Surrogate
from edream.calibration.windows import Sequences

NAMES = catalog.names("surrogates")
QUICK = {"mlp": {"hidden": 24, "members": 2, "epochs": 24, "batch": 96}}


def spring(n: int = 160, t: int = 9, seed: int = 0) -> Sequences:
    """One joint on a spring whose stiffness is the parameter, under random commands."""
    rng = np.random.default_rng(seed)
    unit, dt = rng.uniform(0, 1, (n, 1)), 0.02
    command = np.repeat(rng.uniform(-1, 1, (n, 1, 1)), t, axis=1)
    position, velocity = np.zeros((n, t, 1)), np.zeros((n, t, 1))
    position[:, 0], velocity[:, 0] = rng.uniform(-1, 1, (n, 1)), rng.uniform(-1, 1, (n, 1))
    for k in range(t - 1):
        pull = (20.0 + 80.0 * unit) * (command[:, k] - position[:, k]) - 6.0 * velocity[:, k]
        velocity[:, k + 1] = velocity[:, k] + dt * pull
        position[:, k + 1] = position[:, k] + dt * velocity[:, k + 1]
    which = np.stack([np.arange(n), np.zeros(n, int)], axis=1)
    return Sequences(unit, np.zeros((n, 0)), position, velocity, command, np.full((n, t), dt), np.ones((n, t)), which)


@pytest.fixture(scope="module", params=NAMES)
def learned(request: pytest.FixtureRequest) -> Surrogate:
    return catalog.load("surrogates", request.param, Surrogate).fit(spring(), QUICK.get(request.param, {}), seed=3)


def test_gradient_equals_finite_differences(learned: Surrogate) -> None:
    windows = spring(4, seed=5)
    point = torch.tensor([0.4], dtype=torch.float32, requires_grad=True)
    learned.predict(point, windows).square().sum().backward()
    assert point.grad is not None
    with torch.no_grad():
        ends = [float(learned.predict(torch.tensor([0.4 + h]), windows).double().square().sum()) for h in (1e-2, -1e-2)]
    assert float(point.grad) == pytest.approx((ends[0] - ends[1]) / 2e-2, rel=0.02)


def test_learning_beats_standing_still_on_sets_never_shown(learned: Surrogate) -> None:
    found = learned.errors(spring(64, seed=9))
    assert found["one_step_rad"] < 0.2 * found["standing_still_one_step_rad"]
    assert found["window_rad"] < 0.5 * found["standing_still_window_rad"]


@pytest.mark.parametrize("name", NAMES)
def test_learning_twice_gives_the_same_bytes(name: str) -> None:
    entry = catalog.load("surrogates", name, Surrogate)
    options = QUICK.get(name, {}) | {"epochs": 2}
    first, second = (entry.fit(spring(), options, seed=1).weights() for _ in range(2))
    assert first.keys() == second.keys()
    assert all(np.array_equal(first[key], second[key]) for key in first)


def test_weights_bring_the_same_surrogate_back(learned: Surrogate) -> None:
    again = catalog.load("surrogates", learned.name, Surrogate).load(learned.weights())
    windows = spring(4, seed=5)
    with torch.no_grad():
        assert torch.equal(again.predict(torch.tensor([0.3]), windows), learned.predict(torch.tensor([0.3]), windows))


def test_trust_is_a_finite_disagreement_for_each_set(learned: Surrogate) -> None:
    found = learned.trust(np.array([[0.2], [0.8]]), spring(4, seed=5))
    assert found.shape == (2,) and np.isfinite(found).all() and (found > 0).all()
