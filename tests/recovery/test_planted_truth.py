"""Plant a value, demand it back within its own interval."""

import numpy as np
import pytest

from tests.recovery.planted import coverage, recover


def test_planted_numbers_of_arm6_lie_in_their_intervals() -> None:
    found = [recover(seed, count=3, seconds=6.0) for seed in (0, 1)]
    inside, total, missed = coverage(found)
    assert total >= 36, "too few parameters were called identifiable"
    assert inside >= 0.9 * total, missed
    assert all(one.rms < 7e-4 for one in found)


@pytest.mark.slow
@pytest.mark.timeout(3600)  # on a machine that others use too
def test_planted_numbers_of_arm6_lie_in_their_intervals_over_twenty_seeds() -> None:
    found = [recover(seed) for seed in range(20)]
    inside, total, missed = coverage(found)
    print(f"{inside} of {total} identifiable parameters inside their interval ({inside / total:.1%}), {20 * 24 - total} open")
    per_seed = [np.mean([n.startswith(f"{i}:") for n in missed]) for i in range(20)]
    assert inside >= 0.9 * total, (missed, per_seed)
