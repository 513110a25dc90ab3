"""Where servos reach their limit, usual numbers make up for what is missing, and a score test looks from published ones as well."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edream.diagnosis import astray, left_out
from edream.diagnosis.candidates import Candidate, placement
from edream.diagnosis.nearest import reaching
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.screen import LARGEST_ALPHA, Scored, extend
from edream.diagnosis.starts import STRONG, as_published, in_all_strengths, in_all_strengths_beside_published
from tests.unit.test_shares import recorded, weak

DRAG, SPRING = Candidate("quadratic_drag", ("tilt",)), Candidate("spring", ("tilt",))


@pytest.mark.parametrize("at_limits", [True, False])
def test_what_stands_out_beside_published_numbers_counts_where_servos_reach_their_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_limits: bool
) -> None:
    problem, _ = recorded(weak(tmp_path, 0.5), 4)
    fit = fit_nuisance(problem)
    problem = replace(problem, shared=problem.groups if at_limits else ())
    looked: list[np.ndarray] = []

    def screen(problem: object, there: object, done: object) -> list[Scored]:
        looked.append(there.values)  # type: ignore[attr-defined]
        return [Scored(DRAG, {}, 0.9 if len(looked) > 1 else 0.05), Scored(SPRING, {}, 0.2 if len(looked) > 1 else 0.6)]

    monkeypatch.setattr(astray, "screen", screen)
    monkeypatch.setattr(left_out, "far_off", lambda problem, fit: True)
    monkeypatch.setattr(astray, "worst_joint", lambda problem, fit: "tilt")
    found = [(one.candidate, one.share) for one in astray.screen_twice(problem, fit)]
    assert found == ([(DRAG, 0.9), (SPRING, 0.6)] if at_limits else [(DRAG, 0.05), (SPRING, 0.6)])
    if at_limits:
        published = fit.space.start()
        for name, plain, here in zip(fit.space.names, published, looked[1], strict=True):
            if "tilt" in name and not name.startswith("coulomb"):
                assert here == pytest.approx(plain, rel=1e-6), name
            elif "pan" in name:
                assert here == pytest.approx(fit.space.mapping(fit.values)[name], rel=1e-6), name


def test_what_reaches_a_joint_is_tried_in_all_strengths_beside_fitted_and_published_numbers(tmp_path: Path) -> None:
    problem, _ = recorded(weak(tmp_path, 0.5), 4)
    fit = fit_nuisance(problem)
    reach = [one.candidate for one in reaching(problem, fit, ("tilt",))]
    assert {Candidate("stribeck", ("tilt",)), Candidate("payload", ("head",)), Candidate("gravity_tilt", ())} <= set(reach)
    assert len(set(reach)) == len(reach)
    assert not any("pan" in c.targets for c in reach), "a link or a joint that the joint does not move"
    assert Candidate("coulomb", ("tilt",)) not in reach, "it is in the model already"

    place = placement(problem, Candidate("stribeck", ("tilt",)))
    extended, absent = extend(fit, [place])
    names, starts = extended.simulated.space.names, np.array(in_all_strengths(problem, place, extended, absent))
    apart = np.array(in_all_strengths_beside_published(problem, place, extended, absent))
    torque, usual = names.index("stribeck.torque[tilt]"), np.isin(names, fit.space.names)
    weakest, most = starts[:, torque].min(), place.effect.parameters(problem.robot.model, ["tilt"])[0].high
    assert {round(t / weakest, 6) for t in starts[:, torque]} == {min(s, most / weakest) for s in (1.0, STRONG, LARGEST_ALPHA)}
    np.testing.assert_array_equal(starts[:, torque], apart[:, torque])
    assert (starts[:, usual] == fit.values).all()
    believed = as_published(problem, fit.space.names, fit.values, frozenset({"tilt"}))
    assert (apart[:, usual] == believed).all() and not np.array_equal(believed, fit.values)
