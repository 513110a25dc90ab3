"""Parts of the diagnosis that can be judged alone."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind.cases import robot_of
from edream.core.errors import EdreamError
from edream.core.parameters import Parameter
from edream.diagnosis import decide
from edream.diagnosis.backward import refitted_without, stands
from edream.diagnosis.candidates import Candidate, alike, groups_of, placement
from edream.diagnosis.decide import comes_down_to, rivals, simplest, told_apart
from edream.diagnosis.descent import Fit, begin, descend
from edream.diagnosis.few import representative, thinned
from edream.diagnosis.left_out import falls_short, left_out_errors
from edream.diagnosis.naming import Named, is_strange
from edream.diagnosis.nuisance import fit_nuisance, published
from edream.diagnosis.problem import Problem, Settings, credible, measurement_noise, nuisance_placements, prepare
from edream.diagnosis.remainder import chosen_terms
from edream.diagnosis.rough import rough_candidates, searched
from edream.diagnosis.screen import (
    Scored,
    acts_already,
    extend,
    finalists,
    fits_beside,
    screen,
    with_quantities,
    worthwhile,
)
from edream.diagnosis.starts import as_published
from edream.diagnosis.trials import Trial
from edream.diagnosis.verdict import judge
from edream.diagnosis.wording import contradicted, sentence
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from tests.still_problem import NOISE, commanded, having


def test_the_noise_of_the_measurements_is_found_behind_the_motion(problem: Problem) -> None:
    noise = measurement_noise([w.episode for w in problem.fitted])
    assert np.all((noise > 0.7 * NOISE) & (noise < 1.4 * NOISE))


def test_joints_that_do_not_count_keep_their_published_numbers(problem: Problem) -> None:
    """Nothing says what they are: a gripper that was not scored came out eight times as heavy, and held little."""
    episodes = [window.episode for window in (*problem.fitted, *problem.proof)]
    pan, tilt = problem.robot.joints
    lone = prepare(problem.robot, episodes, Settings(joints=(pan,)))
    assert {place.targets for place in nuisance_placements(lone)} == {(pan,)}
    tied = prepare(problem.robot, episodes, Settings(joints=(pan,), ties=((pan, tilt),)))
    assert {place.targets for place in nuisance_placements(tied)} == {(pan, tilt)}


def test_no_motion_is_both_fitted_and_proof(problem: Problem) -> None:
    fitted, proof = ({w.episode.name for w in windows} for windows in (problem.fitted, problem.proof))
    assert proof and len(fitted) >= 3 and not fitted & proof


def test_motions_held_out_by_pattern_are_the_proof(problem: Problem) -> None:
    episodes = [w.episode for w in (*problem.fitted, *problem.proof)]
    again = prepare(problem.robot, episodes, Settings(holdout=("motion_[12]",)))
    assert {w.episode.name for w in again.proof} == {"motion_1", "motion_2"}
    with pytest.raises(EdreamError, match="motoin_1"):
        prepare(problem.robot, episodes, Settings(holdout=("motoin_1",)))


def test_effects_that_mujoco_cannot_combine_are_not_tried(problem: Problem, fit: Fit) -> None:
    lag = placement(problem, Candidate("actuator_lag", ("tilt",)))
    extended, values = extend(fit, [lag])
    lagging = replace(fit, objective=extended, unit=extended.simulated.space.to_unit(values))
    assert fits_beside(problem, fit, [Candidate("slew_limit", ("tilt",))])
    assert not fits_beside(problem, lagging, [Candidate("slew_limit", ("tilt",))])
    slow, _ = extend(fit, [placement(problem, Candidate("slew_limit", ("tilt",)))])
    slewing = begin(slow, np.append(fit.unit, 0.9))
    assert not fits_beside(problem, slewing, [Candidate("gear_ratio", ("tilt",))])
    assert fits_beside(problem, slewing, [Candidate("gear_ratio", ("pan",))])


def _tried(problem: Problem, fit: Fit, candidate: Candidate, quantities: dict[str, float], closed: float) -> Trial:
    return Trial(candidate, 0.5, having(problem, fit, candidate, quantities), np.full(9, 1e-6), closed, True)


def test_a_mass_that_is_missing_goes_before_one_that_is_too_much_where_motions_tell_no_difference(
    problem: Problem, fit: Fit
) -> None:
    model = problem.robot.model
    first, second = (model.body(int(model.jnt_bodyid[model.joint(name).id])).name for name in problem.robot.joints)
    less = _tried(problem, fit, Candidate("payload", (first,)), {"mass": -0.02}, 0.56)
    more = _tried(problem, fit, Candidate("payload", (second,)), {"mass": 0.03}, 0.54)
    assert simplest(problem, [less, more]) is more and simplest(problem, [more, less]) is more
    assert simplest(problem, [less, replace(more, closed=0.5)]) is less
    assert simplest(problem, [less, replace(more, errors=2.0 * more.errors)]) is less
    spring = _tried(problem, fit, Candidate("spring", ("tilt",)), {"stiffness": 0.1, "reference": 0.2}, 0.54)
    assert simplest(problem, [less, spring]) is spring and simplest(problem, [more, spring]) is more


@pytest.mark.parametrize(("ratio", "first"), [(0.997, "spring"), (0.95, "gear_ratio")])
def test_a_gear_off_by_a_thousandth_gives_way_to_what_motions_do_not_tell_from_it(
    problem: Problem, fit: Fit, ratio: float, first: str
) -> None:
    gear = _tried(problem, fit, Candidate("gear_ratio", ("tilt",)), {"ratio": ratio, "encoder": 1.0006}, 0.56)
    spring = _tried(problem, fit, Candidate("spring", ("tilt",)), {"stiffness": 0.1, "reference": 0.2}, 0.54)
    found = simplest(problem, [gear, spring])
    assert found is not None and found.candidate.effect == first


@pytest.mark.parametrize(("about_x", "first"), [(0.45, "encoder_offset"), (0.2, "gravity_tilt")])
def test_a_base_that_leans_as_nobody_would_leave_it_gives_way(problem: Problem, fit: Fit, about_x: float, first: str) -> None:
    tilt = _tried(problem, fit, Candidate("gravity_tilt", ()), {"about_x": about_x, "about_y": 0.02}, 0.67)
    offset = _tried(problem, fit, Candidate("encoder_offset", ("tilt",)), {"angle": 0.02}, 0.62)
    found = simplest(problem, [tilt, offset])
    assert found is not None and found.candidate.effect == first


@pytest.mark.parametrize(
    ("ended", "half", "there", "down"), [(True, 0.1, 0.1, True), (False, 0.1, 0.1, True), (False, 0.1, 1.2, False)]
)
def test_intervals_from_before_the_end_of_a_search_do_not_rule_a_rival_out(
    problem: Problem, fit: Fit, monkeypatch: pytest.MonkeyPatch, ended: bool, half: float, there: float, down: bool
) -> None:
    """A torque in proportion to the load is what a servo's gain makes up for, which stale columns do not know."""
    even = _tried(problem, fit, Candidate("directional_efficiency", ("tilt",)), {"slope": 0.3, "asymmetry": 0.0}, 0.80)
    name = placement(problem, even.candidate).full_name("asymmetry")
    begun, arrived = (SimpleNamespace(ended=e, intervals=lambda h=h: {name: (-h, h)}) for e, h in ((ended, half), (True, there)))
    monkeypatch.setattr(decide, "polish", lambda fit: arrived)
    assert comes_down_to(problem, replace(even, fit=begun), Candidate("load_friction", ("tilt",))) is down


def test_an_effect_that_comes_down_to_its_special_case_gives_way_to_it(problem: Problem, fit: Fit) -> None:
    def tried(effect: str, quantities: dict[str, float], closed: float) -> Trial:
        return _tried(problem, fit, Candidate(effect, ("tilt",)), quantities, closed)

    plain = tried("load_friction", {"slope": 0.3, "motor_share": 0.1}, 0.79)
    even = tried("directional_efficiency", {"slope": 0.3, "asymmetry": 0.0}, 0.80)
    assert simplest(problem, [even, plain]) is plain and simplest(problem, []) is None
    # over these short motions it may as well be far from its special case, so it remains a rival
    assert not comes_down_to(problem, even, plain.candidate) and not comes_down_to(problem, plain, even.candidate)
    assert rivals(problem, [even, plain], plain) == [(even, False)]
    assert simplest(problem, [even, replace(plain, closed=0.6)]) is even
    # nearly the same share of a large gap may still be a difference that everyone sees
    assert told_apart(problem, replace(plain, errors=2.0 * plain.errors), even)
    assert simplest(problem, [even, replace(plain, errors=2.0 * plain.errors)]) is even
    # a third of the motions may tell what all of them together do not
    some = np.where(np.arange(9) < 3, 1.2e-6, 0.02e-6)
    assert told_apart(problem, replace(plain, errors=plain.errors + some), even)
    assert not told_apart(problem, replace(plain, errors=plain.errors + np.full(9, some.mean())), even)


def test_a_group_one_of_whose_joints_has_the_effect_is_not_tried(problem: Problem, fit: Fit) -> None:
    tied = replace(problem, groups=(("pan", "tilt"),), settings=replace(problem.settings, effects=("presliding", "load_friction")))
    has, absent = extend(fit, [placement(tied, Candidate("presliding", ("tilt",)))])
    tried = [one.candidate for one in screen(tied, begin(has, has.simulated.space.to_unit(absent)))]
    assert Candidate("presliding", ("pan",)) in tried
    assert not [one for one in tried if one.effect == "presliding" and "tilt" in one.targets]
    there = has.simulated.placements
    assert acts_already(Candidate("presliding", ("pan", "tilt")), there)
    assert not acts_already(Candidate("load_friction", ("pan", "tilt")), there)


def test_the_sentence_says_all_joints_rather_than_their_names() -> None:
    joints = ("a", "b", "c")
    one = Named("load_friction", "load-dependent friction", joints, {}, {}, {}, 0.5, None, ("stribeck[a+b+c]", "cogging[a]"))
    said = sentence("cannot_tell", [one], None, joints)
    assert "load-dependent friction on all 3 joints" in said
    assert "load_friction may be stribeck or cogging on a" in said
    most = replace(one, confusable_with=("stribeck[a+c]", "cogging[a+d]", "gravity_tilt"))
    assert "may be stribeck without b or cogging on a and d or gravity_tilt." in sentence("cannot_tell", [most], None, joints)
    assert "on a and b" in sentence("named", [replace(one, targets=("a", "b"))], None, joints)
    twice = [replace(one, targets=(joint,)) for joint in ("a", "c")]
    assert sentence("named", twice, None, joints) == "Your simulator lacks load-dependent friction on a and c."


def test_what_belongs_to_one_assembly_is_not_shared_by_a_hardware_group(problem: Problem) -> None:
    tied = replace(problem, groups=(("pan", "tilt"),))
    joints = [Candidate(effect, (joint,)) for effect in ("load_friction", "encoder_offset") for joint in ("pan", "tilt")]
    assert groups_of(tied, joints) == [Candidate("load_friction", ("pan", "tilt"))]


def test_a_usual_number_is_strange_only_beyond_what_robots_of_a_kind_differ_by() -> None:
    damping = Parameter("damping", "N m s/rad", 1e-3, 10.0, 0.6, scale="log")
    assert is_strange(damping, (0.84, 0.88))
    assert not is_strange(damping, (0.76, 0.88))  # the interval reaches what is usual
    assert is_strange(damping, (0.38, 0.40))


def test_each_effect_is_heard_on_one_joint_and_on_a_group() -> None:
    many = [Scored(Candidate("spring", (f"joint{i}",)), {}, 0.5 - 0.01 * i) for i in range(20)]
    faint = [Scored(Candidate("dead_zone", ("joint1",)), {}, 1e-5), Scored(Candidate("load_friction", ("a", "b")), {}, 0.004)]
    silent = [Scored(Candidate("backlash", ("a", "b")), {}, 0.001), Scored(Candidate("cogging", ("a",)), {}, 0.0)]
    heard = finalists([*many, *faint, *silent])
    assert all(one in heard for one in faint)
    assert not any(one in heard for one in silent)


def test_a_score_test_on_a_few_motions_looks_at_some_that_are_off_most(fit: Fit) -> None:
    windows, owner = fit.objective.windows, fit.objective.owner
    total = sum(float(window.times[-1]) for window in windows)
    assert thinned(fit, total) is fit
    off = np.bincount(owner, fit.residual**2)
    less = thinned(fit, total / 2.5)
    kept = [windows.index(window) for window in less.objective.windows]
    assert kept == sorted(kept) and 1 < len(kept) < len(windows)
    assert int(np.argmax(off)) in kept and off[kept].min() >= np.median(off)
    np.testing.assert_allclose(less.objective.residuals(fit.values)[0], less.residual, atol=1e-12)
    assert less.jacobian.shape == (len(less.residual), len(fit.unit))
    shifted = replace(fit, objective=replace(fit.objective, offset=np.arange(len(fit.residual), dtype=float)))
    np.testing.assert_array_equal(thinned(shifted, total / 2.5).objective.offset, np.flatnonzero(np.isin(owner, kept)))


def test_a_few_motions_stand_for_all_although_some_are_off_by_something_of_their_own() -> None:
    """All are off alike on both joints; three have more on the first of them, one a little more on the second."""
    squares = np.ones((10, 2))
    squares[[1, 2, 3], 0], squares[4, 1] = [9.0, 8.0, 7.0], 4.0
    lasts = np.full(10, 5.0)
    assert representative(squares, lasts, 5.0) == [1], "the one that is off most"
    assert representative(squares, lasts, 10.0) == [1, 4], "not the next, which is off by the same"
    alone = np.array([[5.0, 0.0], [4.0, 0.0], [3.0, 0.0], [0.1, 0.0], [0.2, 0.0], [0.3, 0.0]])
    assert representative(alone, lasts[:6], 15.0) == [0, 1, 2], "those that are off most where all are off on one joint"
    assert representative(alone, lasts[:6], 1e3) == [0, 1, 2, 3, 4, 5]
    kinds = ["usual", "usual", "usual", "soft", "heavy", "soft"]
    assert representative(alone, lasts[:6], 5.0, kinds) == [0, 4, 5], (
        "the one that is off most under each set-up, whatever it lasts"
    )


def test_a_real_gap_that_nothing_explains_is_not_called_agreement() -> None:
    assert judge([], None, False) == "none"
    assert judge([], None, True) == "unnamed"
    said = sentence("unnamed", [], None, ("a",))
    assert "no effect in the library explains" in said and "agrees" not in said


@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_a_formula_has_as_many_terms_as_motions_left_out_bear_out(problem: Problem, fit: Fit, strength: float) -> None:
    rng = np.random.default_rng(4)
    changes = rng.normal(0.0, 1e-4, (40, len(fit.residual)))
    hidden = strength * (3.0 * changes[7] - 2.0 * changes[30])
    rows = rng.normal(0.0, 3e-4, len(fit.residual)) - hidden
    found = chosen_terms(problem, replace(fit, residual=rows), np.vstack([rows, rows + changes]))
    assert set(found) == ({7, 30} if strength else set())


@pytest.mark.parametrize(("speed", "stands_"), [(0.8, True), (0.0500001, False), (999.9, False)])
def test_a_limit_far_below_the_top_of_its_box_is_not_at_its_bound(problem: Problem, fit: Fit, speed: float, stands_: bool) -> None:
    candidate = Candidate("slew_limit", ("tilt",))
    place = placement(problem, candidate)
    extended, absent = extend(fit, [place])
    unit = extended.simulated.space.to_unit(with_quantities(extended, absent, [place], [{"speed": speed}]))
    column = np.full((len(fit.residual), 1), fit.scale)  # so that the number is known well
    assert stands(problem, candidate, Fit(extended, unit, fit.residual, np.hstack([fit.jacobian, column]), fit.scale)) is stands_


@pytest.mark.parametrize(
    ("before", "after", "short"),
    [(5.0, 4.8, True), (5.0, 3.0, False), (5.0, 1.5, False), (1.7, 1.6, False), (3.0, 1.7, False), (30.0, 24.0, True)],
)
def test_names_that_close_little_of_a_real_gap_do_not_pass_for_the_answer(
    problem: Problem, before: float, after: float, short: bool
) -> None:
    first, left = (np.full(4, (floors * problem.floor) ** 2) for floors in (before, after))
    assert falls_short(problem, first, left) is short
    named = Named("spring", "a spring", ("tilt",), {}, {}, {}, 0.1, None, ())
    assert judge([named], None, short) == ("unnamed" if short else "named")
    assert "a spring on tilt, and something else" in sentence("unnamed", [named], None, ("pan", "tilt"))
    said = contradicted([named], ("pan", "tilt"), "1.6 mrad on motions never fitted")
    assert "resembles a spring on tilt on the motions that were fitted, but others contradict that: 1.6 mrad" in said


def test_a_step_that_leads_astray_does_not_judge_a_motion_left_out(problem: Problem, fit: Fit) -> None:
    arrived = descend(fit, None, 6)
    honest = left_out_errors(problem, arrived).mean()
    misled = left_out_errors(problem, replace(arrived, jacobian=0.02 * arrived.jacobian)).mean()  # fifty times too long a step
    assert misled < 1.1 * honest


@pytest.mark.slow
def test_play_in_a_gear_is_found_by_a_search_where_the_usual_numbers_have_made_up_for_it() -> None:
    robot = robot_of("pan_tilt")
    assert robot is not None
    still = prepare(robot, [commanded(i, robot.joints) for i in range(8)], Settings())  # of four it depends on the noise
    hidden = SimulatedRobot(robot, (*nuisance_placements(still), placement(still, Candidate("backlash", ("pan",)))))
    numbers = dict(zip(hidden.space.names, hidden.space.start(), strict=True))
    numbers |= {"backlash.play[pan]": 0.016, "backlash.feedback[pan]": 1.0, "backlash.bearing[pan]": 0.03}
    windows = (*still.fitted, *still.proof)
    moved = rollout(hidden, np.array([hidden.space.vector(numbers)]), windows)
    rng = np.random.default_rng(3)
    made = [replace(w.episode, position=m[0] + rng.normal(0.0, NOISE, m[0].shape)) for w, m in zip(windows, moved, strict=True)]
    looked_at = prepare(robot, made, Settings())
    usual = fit_nuisance(looked_at)
    (candidate,) = rough_candidates(looked_at, usual)
    assert candidate == Candidate("backlash", ("pan",))
    found = searched(looked_at, usual, candidate)
    assert found is not None
    assert found.rms < 0.8 * usual.rms
    assert found.space.mapping(found.values)["backlash.play[pan]"] == pytest.approx(0.016, rel=0.4)


def test_joints_with_the_same_published_drive_are_tried_as_one(problem: Problem, fit: Fit) -> None:
    both = ("pan", "tilt")
    assert alike(problem) == [both]
    assert alike(replace(problem, groups=(both,))) == []  # these are tied already
    effects = ("actuator_delay", "encoder_offset")
    joints = [Candidate(effect, (joint,)) for effect in effects for joint in both]
    assert groups_of(problem, joints) == [Candidate("actuator_delay", both)]


def test_joints_that_are_not_tied_are_tried_as_one_where_that_explains_more_than_one_of_them(problem: Problem) -> None:
    tilt, pan, both = (Candidate("actuator_delay", targets) for targets in (("tilt",), ("pan",), ("pan", "tilt")))
    little = [Scored(tilt, {}, 0.5), Scored(pan, {}, 0.05), Scored(both, {}, 0.55)]
    assert worthwhile(problem, little) == little[:2]
    much = [Scored(tilt, {}, 0.5), Scored(pan, {}, 0.3), Scored(both, {}, 0.8)]
    assert worthwhile(problem, much) == much
    assert worthwhile(replace(problem, groups=(("pan", "tilt"),)), little) == little


def test_an_interval_that_ends_at_the_absent_bound_but_for_rounding_names_nothing(
    problem: Problem, fit: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = Candidate("torque_limit", ("tilt",))
    extended, absent = extend(fit, [placement(problem, limit)])
    unit = extended.simulated.space.to_unit(absent)
    names = extended.simulated.space.names
    unit[names.index("torque_limit.torque[tilt]")] = 0.9  # away from the bound, but nobody knows where
    high = extended.simulated.space.parameters[names.index("torque_limit.torque[tilt]")].high
    found = begin(extended, unit)
    for top, is_there in ((high * (1.0 - 1e-12), False), (0.95 * high, True)):
        intervals = dict.fromkeys(names, (0.0, 1.0)) | {"torque_limit.torque[tilt]": (0.1 * high, top)}
        monkeypatch.setattr(Fit, "intervals", lambda self, known=intervals: known)
        assert stands(problem, limit, found) == is_there


def test_numbers_far_from_the_published_ones_are_not_credible(problem: Problem, fit: Fit) -> None:
    usual = fit.space.mapping(fit.values)
    assert credible(problem, usual)
    assert not credible(problem, usual | {"servo_gain.kp[tilt]": 3.0 * usual["servo_gain.kp[tilt]"]})


def test_a_bias_of_the_measurements_alone_is_the_plain_simulation_counted_from_elsewhere(problem: Problem) -> None:
    window, bias = problem.fitted[0], 0.07
    plain = rollout(SimulatedRobot(problem.robot, ()), np.zeros((1, 0)), [window])[0][0]
    place = placement(problem, Candidate("sensor_bias", ("tilt",)))
    tilt = window.episode.joints.index("tilt")
    shifted = window.episode.position + bias * (np.arange(2) == tilt)
    moved = replace(window, episode=replace(window.episode, position=shifted))
    counted = rollout(SimulatedRobot(problem.robot, (place,)), np.array([[bias]]), [moved])[0][0]
    np.testing.assert_allclose(counted[:, tilt] - bias, plain[:, tilt], atol=1e-6)
    assert np.abs(counted[:, tilt] - plain[:, tilt]).min() > 0.06


def test_a_link_with_the_name_of_a_joint_is_judged_on_all_joints_like_any_other(problem: Problem, fit: Fit) -> None:
    shares = []
    for name in ("head", "tilt"):
        robot = replace(problem.robot, mjcf=problem.robot.mjcf.replace('<body name="head"', f'<body name="{name}"'))
        named = replace(problem, robot=robot, settings=replace(problem.settings, effects=("payload",)))
        simulated = SimulatedRobot(robot, nuisance_placements(named))
        bent = simulated.space.start() * np.where(np.array(simulated.space.names) == "servo_gain.kp[tilt]", 0.8, 1.0)
        found = screen(named, begin(replace(published(named), simulated=simulated), simulated.space.to_unit(bent)))
        shares.append({one.candidate.targets: one.share for one in found}.get((name,)))
    assert shares[0] is not None and shares[0] == shares[1]


def test_without_an_effect_a_search_also_begins_at_the_published_numbers_of_its_joints(problem: Problem) -> None:
    robot, slew, give = problem.robot, Candidate("slew_limit", ("tilt",)), Candidate("compliance", ("tilt",))
    placements = [placement(problem, one) for one in (slew, give)]
    hidden = SimulatedRobot(robot, (*nuisance_placements(problem), placements[0]))
    numbers = hidden.space.mapping(hidden.space.start()) | {"slew_limit.speed[tilt]": 0.5}
    windows = (*problem.fitted, *problem.proof)
    moved = rollout(hidden, np.array([hidden.space.vector(numbers)]), windows)
    made = [replace(w.episode, position=m[0]) for w, m in zip(windows, moved, strict=True)]
    slow = prepare(robot, made, Settings())
    both = SimulatedRobot(robot, (*nuisance_placements(slow), *placements))
    bent = both.space.mapping(both.space.start()) | {"slew_limit.speed[tilt]": 0.5, "compliance.give[tilt]": 0.002}
    bent |= {name: 5.0 * bent[name] for name in ("servo_gain.kp[tilt]", "viscous.damping[tilt]", "armature.inertia[tilt]")}
    values = both.space.vector(bent)
    published_again = as_published(slow, both.space.names, values, frozenset({"tilt"}))
    changed = {name for name, a, b in zip(both.space.names, values, published_again, strict=True) if a != b}
    assert changed == {"servo_gain.kp[tilt]", "viscous.damping[tilt]", "armature.inertia[tilt]"}
    start = begin(replace(published(slow), simulated=both), both.space.to_unit(values))
    found = refitted_without(slow, start, give)
    assert all(p.effect.name != "compliance" for p in found.objective.simulated.placements)
    assert found.rms < 3e-4 < 5e-3 < start.rms


@pytest.mark.slow
def test_a_search_for_play_where_there_is_none_is_given_up_before_all_numbers_go_down(problem: Problem) -> None:
    assert searched(problem, fit_nuisance(problem), Candidate("backlash", ("pan",))) is None
