"""Gymnasium's own checks of the environments."""

import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import edream.gym
from edream import catalog
from edream.core.errors import EdreamError
from edream.reality.truth import seal
from edream.vision.dreamer import Dreamer, Part
from edream.vision.variants import DreamOptions, new_model, variants
from tests.workcells import hidden


@pytest.mark.parametrize("task", catalog.names("tasks"))
def test_gymnasium_finds_nothing_wrong(rendering: None, task: str) -> None:
    env = gymnasium.make(edream.gym.identifier(task), render_mode="rgb_array", height=32, width=32)
    with warnings.catch_warnings():
        warnings.filterwarnings("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")
        check_env(env.unwrapped)
    env.close()


def test_reality_can_be_observed(rendering: None, tmp_path: Path) -> None:
    seal(hidden(), tmp_path / "truth.json")
    env = gymnasium.make("edream/GrabPaperCup-v0", observed="reality", truth=tmp_path / "truth.json", height=32, width=32)
    seen, told = env.reset(seed=0, options={"start": 3})
    assert told["start"] == 3 and seen["cam_high"].shape == (32, 32, 3)
    after, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert env.observation_space.contains(after) and reward == 0.0 and not terminated and not truncated
    assert set(info) >= {"success", "grasped", "distance"}
    env.close()


def test_dreams_can_be_observed_and_repeat_themselves(rendering: None) -> None:
    options = DreamOptions(
        codec=Part("pixel_unshuffle", {"factor": 4}),
        denoiser=Part("unet", {"widths": (24, 32), "heads": 2}),
        objective=Part("bridge", {"noise": 0.1}),
    )
    model = new_model(options, variants(options, ("sim",))[0], 0)
    dreamer = Dreamer(model, np.full((32, 32, 3), 120, np.uint8), seed=1)
    env = gymnasium.make("edream/GrabPaperCup-v0", observed="dreamed", dreamer=dreamer, height=32, width=32)
    seen, action = [], env.unwrapped.world.low * 0.5  # type: ignore[attr-defined]
    for _ in range(2):
        first, _ = env.reset(seed=3)
        seen.append([first["cam_high"], env.step(action)[0]["cam_high"]])
    assert all(np.array_equal(one, two) for one, two in zip(*seen, strict=True))
    assert seen[0][0].shape == (32, 32, 3) and np.abs(seen[0][0].astype(int) - 120).max() > 20  # the robot is in it
    env.close()


def test_numbers_alone_need_no_graphics_and_a_trial_ends_in_time() -> None:
    env = gymnasium.make("edream/GrabPaperCup-v0", observed="state")
    seen, _ = env.reset(seed=0)
    assert seen["cup"].shape == (7,)
    ends = [env.step(np.clip(seen["joints"], env.action_space.low, env.action_space.high))[3] for _ in range(150)]
    assert ends == [False] * 149 + [True]


def test_what_does_not_belong_together_is_refused() -> None:
    with pytest.raises(EdreamError, match="truth"):
        edream.gym.WorkcellEnv(observed="reality")
    with pytest.raises(EdreamError, match="raw"):
        edream.gym.WorkcellEnv(observed="rew")  # type: ignore[arg-type]
