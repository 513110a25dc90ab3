"""Which refitted candidates go on, on made-up trials."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from edream.core.parameters import targets_in
from edream.diagnosis import decide, ends, forward, left_out, trials, verdict
from edream.diagnosis.alone import Searched
from edream.diagnosis.candidates import Candidate, placement
from edream.diagnosis.nuisance import fit_nuisance
from edream.diagnosis.problem import Settings, prepare
from edream.diagnosis.screen import Scored
from edream.diagnosis.suspects import Suspect
from edream.diagnosis.trials import Trial
from edream.sim.rollout import rollout
from edream.sim.simulation import SimulatedRobot
from tests.still_problem import NOISE, FitOf, still_problem, trial_of


def test_rivals_begin_again_from_the_best_ones_numbers_once_for_each_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same effect on one joint less is no other answer; on another link it is."""

    def on(effect: str, *targets: str) -> Trial:
        return replace(trial_of(effect, 0.9), candidate=Candidate(effect, targets))

    best, less = on("load_friction", "a", "b", "c"), on("load_friction", "a", "b")
    others = [
        on("directional_efficiency", "a", "b", "c"),
        on("directional_efficiency", "a"),
        on("payload", "x"),
        on("payload", "y"),
    ]
    begun: list[Candidate] = []
    monkeypatch.setattr(decide, "confused_with", lambda problem, effect: [])
    monkeypatch.setattr(decide, "passes", lambda problem, trial: True)
    monkeypatch.setattr(decide, "leaves_no_gap", lambda problem, fit: False)
    monkeypatch.setattr(decide, "without", lambda fit, candidate: fit)
    monkeypatch.setattr(decide, "beside", lambda problem, bare, candidate: begun.append(candidate))
    monkeypatch.setattr(decide, "judged", lambda problem, fit, errors, trial: replace(trial, closed=0.95))
    found = decide.restarted(SimpleNamespace(settings=SimpleNamespace(threads=1)), np.zeros(4), [best, less, *others])
    assert begun == [others[0].candidate, others[2].candidate, others[3].candidate]
    assert [t.candidate for t in found[:3]] == begun and found[3] is best
    tilted = on("gravity_tilt")  # which has no target
    assert trials.other_answers(tilted, [tilted, best]) == [best]


@pytest.mark.parametrize(
    ("pan", "tilt", "sound", "far"),
    [(0.4, 3.5, False, True), (0.4, 3.5, True, False), (2.5, 2.5, False, False), (25.0, 25.0, True, True)],
)
def test_one_joint_that_is_clearly_off_beside_incredible_numbers_is_far_off(
    monkeypatch: pytest.MonkeyPatch, pan: float, tilt: float, sound: bool, far: bool
) -> None:
    monkeypatch.setattr(left_out, "credible", lambda problem, fitted: sound)
    residual = np.tile([pan, tilt], 50)
    fit = SimpleNamespace(
        residual=residual, rms=float(np.sqrt((residual**2).mean())), values=None, space=SimpleNamespace(mapping=lambda values: {})
    )
    assert left_out.far_off(SimpleNamespace(floor=1.0, joints=("pan", "tilt")), fit) == far


def test_what_does_not_stand_at_the_end_of_its_search_gives_way_to_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    limit, spring = (replace(trial_of(name, 0.9), fit=FitOf(name, 2.0)) for name in ("torque_speed_limit", "spring"))
    monkeypatch.setattr(forward, "simplest", lambda problem, left: left[0] if left else None)
    monkeypatch.setattr(forward, "arrived", lambda problem, fit, taken: taken.candidate.effect)
    monkeypatch.setattr(forward, "polish", lambda fit: fit)
    monkeypatch.setattr(forward, "stands", lambda problem, candidate, ended: candidate.effect == "spring")
    assert forward.first_that_stands(None, "before", [limit, spring]) == (spring, "spring")
    assert forward.first_that_stands(None, "before", [limit]) == (None, "before")
    monkeypatch.setattr(forward, "polish", lambda fit: pytest.fail("it is at its end already"))
    there = replace(spring, fit=FitOf("spring", 1.0, ended=True))
    assert forward.first_that_stands(SimpleNamespace(floor=1.0), "before", [there]) == (there, there.fit)


def test_the_joints_of_a_number_are_told_by_whole_names() -> None:
    assert targets_in("servo_gain.kp[joint1+joint2]") == {"joint1", "joint2"}
    assert targets_in("joint_coupling.stiffness[joint10<-joint2]") == {"joint10", "joint2"}


@pytest.mark.parametrize(
    ("left", "end", "polished"), [(2.0, 1.5, ["delay", "lag"]), (2.0, 0.9, ["delay"]), (1.4, 0.9, ["delay", "lag"]), (1.0, 0.9, [])]
)
def test_rivals_go_to_the_end_of_their_valleys_where_the_best_leaves_a_gap(
    monkeypatch: pytest.MonkeyPatch, left: float, end: float, polished: list[str]
) -> None:
    def trial(name: str, closed: float) -> Trial:
        fit = FitOf(name, left)
        return Trial(Candidate(name, ("tilt",)), 0.0, fit, np.zeros(4), closed, True)

    ended: list[str] = []
    monkeypatch.setattr(decide, "is_brief", lambda fit: True)
    monkeypatch.setattr(decide, "passes", lambda problem, t: True)
    monkeypatch.setattr(decide, "worth", lambda objective, residual: 1.0)
    monkeypatch.setattr(decide, "descend", lambda fit, fresh, iterations: fit)
    monkeypatch.setattr(ends, "polish", lambda fit: ended.append(fit.name) or replace(fit, rms=end))
    monkeypatch.setattr(decide, "judged", lambda problem, fit, errors, t: replace(t, fit=fit, closed=1.0 / fit.rms))
    problem = SimpleNamespace(floor=1.0, shared=(), settings=SimpleNamespace(gain=0.1, threads=1))
    trials_ = [trial("delay", 0.8), trial("lag", 0.5), trial("spring", 0.3)]
    found = decide.settled(problem, FitOf("before", 2.0), np.zeros(4), trials_)
    assert ended == polished and len(found) == 3
    assert found[-1].candidate.effect == "spring" and found[-1].closed == 0.3  # too far behind
    doubtful = [replace(trial("delay", 0.05), sure=False), trial("spring", 0.01)]  # too little to go on with, and not sure
    assert decide.settled(problem, FitOf("before", 2.0), np.zeros(4), doubtful) == doubtful and ended == polished


def test_the_best_goes_on_where_half_way_there_it_is_not_sure_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = {name: FitOf(name, 2.0) for name in ("dead_zone", "lag")}
    best, behind = (
        Trial(Candidate(n, ("pan",)), 0.0, fits[n], np.zeros(4), c, False) for n, c in (("dead_zone", 0.4), ("lag", 0.35))
    )
    monkeypatch.setattr(decide, "is_brief", lambda fit: True)
    monkeypatch.setattr(decide, "passes", lambda problem, t: t.sure)
    monkeypatch.setattr(decide, "worth", lambda objective, residual: 1.0)
    monkeypatch.setattr(decide, "descend", lambda fit, fresh, iterations: replace(fit, rms=1.0))
    monkeypatch.setattr(decide, "judged", lambda problem, fit, errors, t: replace(t, fit=fit, closed=1.0, sure=True))
    problem = SimpleNamespace(floor=1.0, shared=(), settings=SimpleNamespace(gain=0.1, threads=1))
    found = decide.settled(problem, FitOf("before", 2.0), np.zeros(4), [best, behind])
    assert [(t.candidate.effect, t.sure, t.closed) for t in found] == [("dead_zone", True, 1.0), ("lag", False, 0.35)]


def _diagnosed(monkeypatch: pytest.MonkeyPatch, strange: verdict.Named, told: dict[str, object]) -> verdict.Diagnosis:
    """A diagnosis of which all is told; one usual number is strange in it, and no formula holds."""
    always = {
        "published": lambda problem: None,
        "strange_numbers": lambda problem, fit: [strange],
        "most_ordinary": lambda problem, fit: fit,
        "off_nominal": lambda problem, fit: [strange],
        "polish": lambda fit: fit,
        "with_true_slopes": lambda fit: fit,
        "without_numbers": lambda problem, fit, numbers, suspects: FitOf(
            f"without {suspects[0].candidate.effect if suspects else numbers[0].name}", 1.0
        ),
        "does_better": lambda problem, fit, other, seen=0.1: True,
        "placement": lambda problem, candidate: candidate,
        "numbers_of": lambda problem, fit, place: ({}, {}, {}),
        "find_remainder": lambda problem, fit, beside_names=False: None,
        "in_a_plain_loop": lambda problem: problem,
        "for_a_plain_loop": lambda problem, fit: (problem, fit),
        "as_written": lambda one, found, written: one,
        "on_steps": lambda problem, written, unstable: "",
        "unstable_on": lambda problem, fit: (),
        "stands": lambda problem, candidate, fit: True,
        "where_it_shows": lambda problem, fit: "",
        "proof_squares": lambda problem, fit: told["proof_errors"](problem, fit)[:, None],
        "is_contradicted": lambda problem, left, without, beside, proof: False,
    }
    for name, value in (always | told).items():
        monkeypatch.setattr(verdict, name, value)
    robot = SimpleNamespace(joints=("pan", "tilt"))
    return verdict.diagnose(SimpleNamespace(floor=1e-3, robot=robot, creep=None, settings=SimpleNamespace(seed=0)))


@pytest.mark.parametrize(
    ("floors", "behind", "better", "expected", "named", "shown", "written"),
    [
        (1.0, False, ["usual"], "named", ["servo_gain"], "without servo_gain", "usual"),
        (6.0, False, ["usual"], "unnamed", [], "usual", "usual"),
        (1.0, True, ["usual", "with a spring"], "cannot_tell", ["spring"], "without spring", "with a spring"),
        (1.0, True, ["usual"], "named", ["servo_gain"], "without servo_gain", "usual"),
        (1.0, True, [], "none", [], "without servo_gain", "without servo_gain"),
        (1.0, False, [], "none", [], "without servo_gain", "without servo_gain"),
        (6.0, True, ["usual", "with a spring"], "unnamed", [], "usual", "usual"),
    ],
)
def test_strange_numbers_are_an_answer_only_where_nothing_is_left(
    monkeypatch: pytest.MonkeyPatch,
    floors: float,
    behind: bool,
    better: list[str],
    expected: str,
    named: list[str],
    shown: str,
    written: str,
) -> None:
    """What stands behind them is named instead, and is in the model that is written; neither where ordinary ones do as well, and
    the numbers themselves where these do as well as what stands behind them alone."""
    spring = Suspect(Candidate("spring", ("tilt",)), FitOf("with a spring", 1.0), 9.0)  # type: ignore[arg-type]
    gain = verdict.Named("servo_gain", "another servo gain", ("tilt",), {}, {}, {}, 0.0, None, ())
    errors = np.full(4, (floors * 1e-3) ** 2)
    nothing = decide.Round(FitOf("usual", 1.0), errors, [], [], None)
    told = {
        "proof_errors": lambda problem, fit: errors,
        "searched": lambda problem, done: Searched(problem, FitOf("usual", 1.0), [nothing]),  # type: ignore[arg-type]
        "backward": lambda problem, fit, candidates, first: (fit, []),
        "find_suspects": lambda problem, fit, strange, done: [spring] if behind else [],
        "does_better": lambda problem, fit, other, seen=0.1: fit.name in better,
    }
    found = _diagnosed(monkeypatch, gain, told)
    assert found.verdict == expected and [one.name for one in found.effects] == named
    assert ("servo gain" in found.sentence) is ("servo_gain" in named)
    assert (found.before.name, found.after.name) == (shown, written)  # type: ignore[attr-defined]
    assert [label for label, _ in found.ladder] == ["published", "calibrated", *(f"+ {name}[tilt]" for name in named)]
    assert [label for label, _ in found.contenders] == (["strange numbers", "spring[tilt]"] if expected == "cannot_tell" else [])


@pytest.mark.parametrize(
    ("strange", "floors", "behind", "stays", "expected", "named"),
    [
        ("servo_gain", 1.0, True, True, "cannot_tell", ["stribeck", "spring"]),
        ("servo_gain", 1.0, True, False, "named", ["spring"]),  # which explains what had been named
        ("servo_gain", 1.0, False, True, "named", ["stribeck"]),
        ("servo_gain", 2.0, True, True, "named", ["stribeck"]),
        ("armature", 1.0, True, True, "named", ["stribeck"]),
    ],
)
def test_behind_numbers_that_are_strange_beside_a_name_another_effect_is_looked_for(
    monkeypatch: pytest.MonkeyPatch, strange: str, floors: float, behind: bool, stays: bool, expected: str, named: list[str]
) -> None:
    """A strange number with nothing behind it is no finding there, beside a real gap it has made up for that, and a rotor that is
    strange alone hides nothing."""
    spring = Suspect(Candidate("spring", ("tilt",)), FitOf("with both", 1.0), 9.0)  # type: ignore[arg-type]
    gain, friction = (verdict.Named(name, name, ("tilt",), {}, {}, {}, 0.0, None, ()) for name in (strange, "stribeck"))
    taken = replace(trial_of("stribeck", 1.0), fit=FitOf("with stribeck", 1.0))  # type: ignore[arg-type]
    rounds = [decide.Round(FitOf("usual", 1.0), np.full(4, 36e-6), [], [taken], taken)]  # type: ignore[arg-type]
    written: list[str] = []
    told = {
        "proof_errors": lambda problem, fit: np.full(4, 1e-6),
        "predicted": lambda problem, fit, taken: np.full(4, floors**2 * 1e-6),
        "searched": lambda problem, done: Searched(problem, taken.fit, rounds),
        "backward": lambda problem, fit, candidates, first: (fit, candidates),
        "find_suspects": lambda problem, fit, strange, done: [spring] if behind else [],
        "what_stays": lambda problem, trials, suspects, first: (suspects, trials if stays else []),
        "_named": lambda problem, fit, trial, rounds, trials: written.append(fit.name) or friction,
    }
    found = _diagnosed(monkeypatch, gain, told)
    assert found.verdict == expected and [one.name for one in found.effects] == named
    last = "spring" in named
    assert found.after.name == ("with both" if last else "with stribeck")  # type: ignore[attr-defined]
    assert written == ([found.after.name] if stays else [])  # type: ignore[attr-defined]
    assert found.before.name == ("usual" if stays else "without spring")  # type: ignore[attr-defined]
    assert [label for label, _ in found.contenders] == (["strange numbers", "spring[tilt]"] if last and stays else [])


def test_beside_a_lag_the_numbers_of_its_joint_are_differenced_anew() -> None:
    """They had made up for it, and what they do beside it is something else: without that, two delays are told apart wrongly."""
    bare = still_problem()
    windows = (*bare.fitted, *bare.proof)
    lagging = SimulatedRobot(bare.robot, (placement(bare, Candidate("actuator_lag", ("tilt",))),))
    moved = rollout(lagging, np.array([[0.03]]), windows)
    rng = np.random.default_rng(8)
    noisy = [replace(w.episode, position=m[0] + rng.normal(0.0, NOISE, m[0].shape)) for w, m in zip(windows, moved, strict=True)]
    problem = prepare(bare.robot, noisy, Settings())
    fit = fit_nuisance(problem)
    lag = Scored(Candidate("actuator_lag", ("tilt",)), {"time": 0.01}, 0.3)
    stale, fresh = (trials.refitted(problem, fit, lag, 3, joints) for joints in (frozenset(), frozenset({"tilt"})))
    assert fresh.rms < 0.95 * stale.rms


@pytest.mark.parametrize(
    ("name", "formula", "outdone"),
    [(18.0, 6.0, True), (18.0, 16.0, False), (10.0, 1.2, False), (None, 6.0, True), (None, None, False)],
)
def test_a_formula_goes_before_a_name_that_closes_little_of_a_real_gap(
    monkeypatch: pytest.MonkeyPatch, name: float | None, formula: float | None, outdone: bool
) -> None:
    """What each leaves of a gap of five floors, squared; None where there is no such thing."""
    problem = SimpleNamespace(floor=1.0, settings=SimpleNamespace(seed=0))
    names = [] if name is None else [replace(trial_of("backlash", 0.3), errors=np.full(6, name))]
    found = None if formula is None else SimpleNamespace(real=True, errors=np.full(6, formula))
    monkeypatch.setattr(forward, "find_remainder", lambda problem, fit: found)
    assert forward.outdone(problem, None, np.full(6, 25.0), names) is (found if outdone else None)


def test_no_formula_is_looked_for_where_no_gap_is_worth_a_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forward, "find_remainder", lambda problem, fit: pytest.fail("a small gap"))
    assert forward.outdone(SimpleNamespace(floor=1.0), None, np.full(6, 2.0), []) is None


def _rounds(monkeypatch: pytest.MonkeyPatch, left: list[float], joint_errors: list[float]) -> list[decide.Round]:
    """Rounds that find a spring on `tilt`, where there is a joint `pan`; `left`: what each begins with, in floors squared."""
    remaining = itertools.chain(left, itertools.repeat(left[-1]))
    told = {
        "with_short_steps": lambda problem, fit: (problem, fit),
        "predicted": lambda problem, fit, taken: np.full(6, next(remaining)),
        "screen_twice": lambda problem, fit, done: [],
        "try_best": lambda problem, fit, errors, scored, done: [trial_of("spring", 0.3)],
        "nearer_without": lambda fit, trials: None,
        "with_bold": lambda problem, fit, errors, trials, done: trials,
        "with_rough": lambda problem, fit, errors, trials, done: trials,
        "with_put_back": lambda problem, fit, errors, trials, done: trials,
        "with_confusable": lambda problem, fit, errors, scored, trials, done: trials,
        "settled": lambda problem, fit, errors, trials: trials,
        "restarted": lambda problem, errors, trials: trials,
        "simplified": lambda problem, fit, errors, trials: trials,
        "outdone": lambda problem, fit, errors, trials: None,
        "passes": lambda problem, trial: True,
        "first_that_stands": lambda problem, fit, passing: (passing[0] if passing else None, fit),
        "narrowed": lambda problem, fit, errors, taken, ended: (replace(taken, share=0.2), fit),
    }
    for name, stand_in in (
        told
        | {
            "stands": lambda *one: True,
            "doubted_instead": lambda problem, fit, rounds, done: (fit, rounds),
            "told_apart": lambda *one: False,
        }
    ).items():
        monkeypatch.setattr(forward, name, stand_in)
    monkeypatch.setattr(left_out, "gained_on", lambda problem, joints, before, after: 0.0)
    monkeypatch.setattr(left_out, "joint_errors", lambda problem, fit: np.array(joint_errors))
    problem = SimpleNamespace(floor=1.0, joints=("tilt", "pan"), settings=SimpleNamespace(most=4, nuisance=()))
    return forward.forward(problem, SimpleNamespace(rms=9.0))[2]


@pytest.mark.parametrize(("left", "names"), [([100.0, 90.0, 80.0, 70.0], 2), ([100.0, 90.0, 40.0, 1.0], 3)])
def test_after_two_names_that_close_less_than_half_no_third_is_looked_for(
    monkeypatch: pytest.MonkeyPatch, left: list[float], names: int
) -> None:
    rounds = _rounds(monkeypatch, left, [1.0, 1.0])
    assert [one.taken is not None for one in rounds] == [True] * names + [False]
    assert all(one.taken in one.trials for one in rounds[:names]), "as it was taken, narrowed perhaps"


@pytest.mark.parametrize("left", [[200.0**2, 1.2**2], [200.0**2, 1.0], [1.0]])
@pytest.mark.parametrize(("joint_errors", "looked"), [([2.0, 1.0], False), ([0.4, 2.0], True), ([0.4, 1.4], False)])
def test_little_is_looked_into_after_a_large_effect_where_it_is_left_on_another_joint(
    monkeypatch: pytest.MonkeyPatch, left: list[float], joint_errors: list[float], looked: bool
) -> None:
    """A twentieth of the first gap is ten floors; 0.2 are left, or none in the mean over joints, which hides what one is off by."""
    rounds = _rounds(monkeypatch, left, joint_errors)
    assert bool(rounds[len(left) - 1].trials) is (looked if len(left) > 1 else 2.0 in joint_errors)


@pytest.mark.parametrize(("bare", "worth"), [({"pan"}, True), ({"tilt"}, False), (set(), False)])
def test_a_small_gain_is_worth_a_name_where_it_is_made_on_a_joint_without_one(bare: set[str], worth: bool) -> None:
    """A payload, which acts on no joint alone, takes half a floor from pan and leaves tilt; a twentieth of the first gap is ten."""
    problem = SimpleNamespace(floor=1.0, joints=("tilt", "pan"))
    fit, after = (SimpleNamespace(residual=np.tile([1.0, pan], 5)) for pan in (1.5, 1.0))
    trial = Trial(Candidate("payload", ("head",)), 0.0, after, np.full(6, 1.0), 0.9, True)
    assert forward.matters(problem, np.full(6, 200.0**2), np.full(6, 1.3**2), fit, trial, frozenset(bare)) is worth
