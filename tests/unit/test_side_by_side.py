"""Independent searches on several threads give what one after the other would."""

import threading
from dataclasses import replace

import mujoco
import pytest

from edream.diagnosis.descent import Fit
from edream.diagnosis.left_out import left_out_errors
from edream.diagnosis.problem import Problem
from edream.diagnosis.screen import screen
from edream.diagnosis.side_by_side import side_by_side
from edream.diagnosis.trials import try_best
from edream.sim.quiet import quiet


def test_results_come_in_the_order_of_the_items_whichever_thread_is_first() -> None:
    second = threading.Event()

    def work(item: int) -> int:
        if item == 0:
            assert second.wait(30.0)
        else:
            second.set()
        return 10 * item

    assert list(side_by_side(work, [0, 1], threads=2)) == [0, 10]
    assert list(side_by_side(lambda item: item, [], threads=2)) == []


def test_an_error_in_a_thread_comes_out() -> None:
    def work(item: int) -> int:
        if item == 1:
            raise ValueError("one")
        return item

    with pytest.raises(ValueError, match="one"):
        list(side_by_side(work, [0, 1, 2], threads=2))


def test_a_search_finds_the_same_on_one_thread_and_on_two(problem: Problem, fit: Fit) -> None:
    errors = left_out_errors(problem, fit)
    found = []
    for threads in (1, 2):
        own = replace(problem, settings=replace(problem.settings, threads=threads, effects=("stribeck", "spring", "actuator_lag")))
        scored = screen(own, fit)
        trials = try_best(own, fit, errors, [replace(one, share=max(one.share, 0.02)) for one in scored])
        found.append([(one.candidate, one.share) for one in scored] + [(t.candidate, t.closed, *t.fit.values) for t in trials])
    assert found[0] == found[1] and len(found[0]) > 3


def test_what_mujoco_warned_and_timed_by_is_put_back_after_the_last_of_several_threads() -> None:
    said: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    own = mujoco.get_mju_user_warning()
    both = threading.Barrier(2)
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>")
    data = [mujoco.MjData(model) for _ in range(3)]

    def seconds(number: int) -> float:
        mujoco.mj_step(model, data[number], 50)
        return float(data[number].timer[mujoco.mjtTimer.mjTIMER_STEP].duration)

    def work(item: int) -> float:
        with quiet():
            both.wait(30.0)
            return seconds(item)

    try:
        assert list(side_by_side(work, [0, 1], threads=2)) == [0.0, 0.0]
        assert mujoco.get_mju_user_warning() is own
        assert seconds(2) > 0.0
    finally:
        mujoco.set_mju_user_warning(before)
