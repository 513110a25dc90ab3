"""Policies: what they learn, what they say of likelihood, and that nothing but chance makes two trials differ."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from edream import catalog
from edream.core.errors import EdreamError
from edream.core.policy import Observation
from edream.executor import create
from edream.ingest.episode_file import write_episode
from edream.ingest.episode_read import read_episode
from edream.learn.determinism import deterministic
from edream.learn.policy import Policy, PolicyShape, Scale, Seen, log_likelihood, masked_l1
from edream.learn.training import Ahead, Schedule, new_state, train
from edream.practice.collecting import Manner, Player, Shard, collected, outcomes_of, played, split
from edream.practice.demonstrations import ChunkBatches, chunk_of
from edream.practice.film import episode_of, film_of, moving_picture
from edream.practice.options import SftOptions
from edream.practice.shaking import Shake, shaken
from edream.practice.trial import Chance, OwnEyes, Plans, play
from edream.stages.sft import heldout_l1, judged
from edream.store import Store
from edream.work import StageWork
from tests.toy_world import SIZE, SMALL, ToyWorld, about, demonstrated, kept, open_toy

SHAPE = PolicyShape(2, 6, 1, SIZE, SIZE, 0)


def trained(demos, about_, steps: int, first: int = 0, state=None):
    batches = ChunkBatches(demos, about_, 16, 0)
    network = about_.network(seed=1)
    state = new_state(network) if state is None else state

    def loss_of(step: int) -> torch.Tensor:
        seen, actions, valid, chance = batches.at(step)
        return network.loss(seen, actions, valid, chance)

    with deterministic(1):
        state, losses = train(network, loss_of, state, first, steps, Schedule(steps=400, rate=3e-3, average=0.9))
    return network.eval(), state, losses


def off(network, demos, about_) -> float:
    batches = ChunkBatches(demos, about_, 16, 0)
    seen, actions, valid = batches.of(batches.every(1))
    with torch.no_grad():
        return float(masked_l1(network.chunk(seen), actions, valid))


@pytest.mark.parametrize("name", catalog.names("policies"))
@pytest.mark.parametrize("state", [False, True], ids=["camera", "state"])
def test_a_policy_overfits_two_episodes(name: str, state: bool) -> None:
    demos = [demonstrated(1, state), demonstrated(2, state)]
    about_ = about(demos)
    before = off(about_.network(seed=1).eval(), demos, about_)
    network, _, _ = trained(demos, about_, 400)
    assert off(network, demos, about_) < 0.1 * before


def test_a_policy_with_nothing_left_to_chance_repeats_itself_and_z_changes_what_it_does() -> None:
    policy = catalog.load("policies", "act", Policy)
    torch.manual_seed(0)
    network = policy.build(SHAPE, SMALL).eval()
    seen = Seen(torch.randn(3, 2), torch.randint(0, 255, (3, 1, SIZE, SIZE, 3), dtype=torch.uint8), torch.zeros(3, 0))
    assert network.chunk(seen).shape == (3, 6, 2)
    assert torch.equal(network.chunk(seen), network.chunk(seen))
    assert not torch.equal(network.chunk(seen), network.chunk(seen, torch.ones(3, 4)))


def test_padding_teaches_nothing() -> None:
    torch.manual_seed(0)
    network = catalog.load("policies", "act", Policy).build(SHAPE, SMALL).eval()
    seen = Seen(torch.randn(2, 2), torch.zeros(2, 1, SIZE, SIZE, 3, dtype=torch.uint8), torch.zeros(2, 0))
    actions, valid = torch.randn(2, 6, 2), torch.tensor([[True] * 4 + [False] * 2] * 2)
    other = actions.clone()
    other[:, 4:] = 99.0
    losses = [network.loss(seen, one, valid, torch.Generator().manual_seed(3)) for one in (actions, other)]
    assert torch.allclose(losses[0], losses[1], atol=1e-6)
    values, mask = chunk_of(np.arange(10.0).reshape(5, 2), 3, 4)
    assert mask.tolist() == [True, True, False, False] and values[2].tolist() == [8.0, 9.0]


@pytest.mark.parametrize("backbone", ["small_conv", "resnet18"])
@pytest.mark.parametrize("cameras", [1, 3])
def test_a_policy_takes_one_or_three_views_with_either_backbone(backbone: str, cameras: int) -> None:
    shape = PolicyShape(7, 5, cameras, 32, 48, 9)
    network = catalog.load("policies", "act", Policy).build(shape, SMALL | {"backbone": backbone, "dropout": 0.1})
    seen = Seen(torch.randn(2, 7), torch.zeros(2, cameras, 32, 48, 3, dtype=torch.uint8), torch.randn(2, 9))
    loss = network.loss(seen, torch.randn(2, 5, 7), torch.ones(2, 5, dtype=torch.bool), torch.Generator().manual_seed(0))
    loss.backward()
    still = [name for name, one in network.named_parameters() if one.grad is None]
    assert not still, f"no gradient reaches {still}"


def test_an_unknown_option_of_a_policy_is_a_sentence() -> None:
    with pytest.raises(EdreamError, match="Did you mean 'latent'"):
        catalog.load("policies", "act", Policy).build(SHAPE, {"latnet": 3})


def test_log_likelihood_is_the_laplace_and_the_gaussian_that_hand_computes() -> None:
    actions, mean = torch.tensor([[[1.0, 2.0], [9.0, 9.0]]]), torch.tensor([[[0.5, 2.25], [0.0, 0.0]]])
    valid = torch.tensor([[True, False]])
    laplace = -(0.5 + 0.25) / 0.1 - 2 * np.log(0.2)
    gaussian = -(0.25 + 0.0625) / 0.02 - 2 * np.log(0.1 * np.sqrt(2 * np.pi))
    assert float(log_likelihood(actions, mean, valid, 0.1, "laplace")) == pytest.approx(laplace, rel=1e-5)
    assert float(log_likelihood(actions, mean, valid, 0.1, "gaussian")) == pytest.approx(gaussian, rel=1e-5)


def test_scales_go_there_and_back_and_do_not_blow_up_a_joint_that_stands_still() -> None:
    rng = np.random.default_rng(0)
    values = np.concatenate([rng.normal(3.0, 2.0, (50, 1)), np.full((50, 1), 0.4)], axis=1)
    scale = Scale.of(values)
    assert np.allclose(scale.back(scale.into(values)), values, atol=1e-5)
    assert np.abs(scale.into(np.array([[3.0, 0.41]]))).max() < 2.0


def test_temporal_ensembling_weighs_the_oldest_chunk_most() -> None:
    plans = Plans(0.5)
    plans.add(0, np.zeros((4, 1)))
    plans.add(2, np.ones((4, 1)))
    assert plans.action(2)[0] == pytest.approx(np.exp(-0.5) / (1 + np.exp(-0.5)))
    assert plans.action(5)[0] == 1.0
    newest = Plans(None)
    newest.add(0, np.zeros((4, 1)))
    newest.add(2, np.ones((4, 1)))
    assert newest.action(2)[0] == 1.0


def test_shaken_images_change_and_follow_from_their_generator() -> None:
    images = np.random.default_rng(0).integers(0, 255, (2, 1, 16, 16, 3)).astype(np.uint8)
    one, two = (shaken(images, Shake(), np.random.default_rng(4)) for _ in range(2))
    assert np.array_equal(one, two) and not np.array_equal(one, images)
    still = Shake(0.0, 0.0, 0.0, 0.0, 0)
    assert np.array_equal(shaken(images, still, np.random.default_rng(4)), images)


def test_training_in_pieces_gives_the_same_bytes() -> None:
    demos = [demonstrated(1), demonstrated(2)]
    about_ = about(demos)
    _, whole, losses = trained(demos, about_, 12)
    _, half, first = trained(demos, about_, 6)
    _, pieces, second = trained(demos, about_, 12, 6, half)
    assert losses == first + second
    assert all(np.array_equal(whole[name], pieces[name]) for name in whole)


def test_what_is_made_ahead_is_what_the_step_would_have_made() -> None:
    made: list[int] = []

    def batch(step: int) -> np.ndarray:
        made.append(step)
        return np.random.default_rng(step).standard_normal(3)

    with Ahead(batch, 7) as ahead:
        found = [ahead.at(step) for step in (3, 4, 5, 6)]
        assert made == [3, 4, 5, 6], "each once, in order, none beyond the last"
        assert np.array_equal(ahead.at(2), batch(2)), "a step out of order is made anew"
    assert all(np.array_equal(one, np.random.default_rng(step).standard_normal(3)) for step, one in enumerate(found, 3))


def test_chance_alone_makes_trials_of_one_start_differ() -> None:
    demos = [demonstrated(1), demonstrated(2)]
    about_ = about(demos)
    network = about_.network(seed=1).eval()
    calm = [play(ToyWorld(), network, about_, OwnEyes(), 5, sample) for sample in (0, 1)]
    assert np.array_equal(calm[0].actions, calm[1].actions) and calm[0].outcome == calm[1].outcome
    for chance in (Chance(joints=0.1), Chance(latent=1.0), Chance(action=0.3)):
        wild = [play(ToyWorld(), network, about_, OwnEyes(), 5, sample, chance) for sample in (0, 1)]
        again = play(ToyWorld(), network, about_, OwnEyes(), 5, 1, chance)
        assert not np.array_equal(wild[0].actions, wild[1].actions), chance
        assert np.array_equal(again.actions, wild[1].actions)


def test_one_and_four_workers_give_the_same_numbers(tmp_path: Path) -> None:
    demos = [demonstrated(1), demonstrated(2)]
    about_ = about(demos)
    player = Player(kept(tmp_path, about_, about_.network(seed=1)), about_.plain())
    turns = split([(start, sample) for start in range(6) for sample in range(2)], 3)
    manner = Manner(Chance(0.05, 0.0, 1.0, 0.2), seed=3)
    found = []
    for workers in (1, 4):
        work = StageWork(Store(tmp_path / f"runs{workers}"), "rollouts", "ab" * 10, create("local", workers))
        shards = collected(work, "trials", player, [Shard(partial(open_toy, 0.1), one) for one in turns], manner)
        found.append((outcomes_of(shards), [shard["trials.safetensors"] for shard in shards]))
    assert found[0][0].equals(found[1][0]) and len(found[0][0]) == 12
    for a, b in zip(found[0][1], found[1][1], strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)
    assert not np.array_equal(found[0][1][0]["actions"][0], found[0][1][0]["actions"][1])


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_policy_acts_where_it_is_told_to(tmp_path: Path) -> None:
    about_ = about([demonstrated(1), demonstrated(2)])
    player = Player(kept(tmp_path, about_, about_.network(seed=1)), about_.plain(), "cuda")
    with pytest.raises(EdreamError, match=r"policy\.device is cuda, .* no GPU"):
        played(Shard(partial(open_toy, 0.1), ((1, 0),)), np.random.default_rng(0), player=player, manner=Manner())


def test_a_policy_for_another_world_is_a_sentence() -> None:
    demos = [demonstrated(1), demonstrated(2)]
    about_ = about(demos)
    world = ToyWorld()
    world.rate = 20.0
    with pytest.raises(EdreamError, match=r"policy\.rate=20"):
        play(world, about_.network(seed=1).eval(), about_, OwnEyes(), 1)


def test_a_filmed_trial_is_an_episode_and_a_moving_picture(tmp_path: Path) -> None:
    about_ = about([demonstrated(1), demonstrated(2)])
    film: list[Observation] = []
    trial = play(ToyWorld(), about_.network(seed=1).eval(), about_, OwnEyes(), 5, film=film)
    arrays = film_of(film, trial)
    write_episode(episode_of(arrays, "trial", about_.order, about_.rate, {"outcome": "failure"}), tmp_path / "trial.mcap")
    episode = read_episode(tmp_path / "trial.mcap")
    assert np.array_equal(episode.command, trial.actions) and np.array_equal(episode.position[0], film[0].joints)
    assert np.array_equal(np.stack(list(episode.videos["cam"].frames())), arrays["images/cam"])
    assert moving_picture(arrays, about_.rate).startswith(b"\x89PNG")


def test_hidden_joints_are_hidden_in_their_share_of_samples_and_nothing_else_is() -> None:
    demos = [demonstrated(1, True), demonstrated(2, True)]
    about_ = about(demos)
    shown, _, _, _ = ChunkBatches(demos, about_, 400, 3).at(5)
    seen, _, _, _ = ChunkBatches(demos, about_, 400, 3, hidden=0.5).at(5)
    blank = (seen.joints == 0.0).all(dim=1)
    assert 0.4 < float(blank.float().mean()) < 0.6
    assert torch.equal(seen.joints[~blank], shown.joints[~blank])
    assert torch.equal(seen.images, shown.images) and torch.equal(seen.state, shown.state)


def test_held_out_demonstrations_are_judged_without_joints_too_where_training_hides_them() -> None:
    demos = [demonstrated(1, True), demonstrated(2, True)]
    known = about(demos)
    network, judge = known.network(seed=3), ChunkBatches(demos, known, 8, 3)
    plain = heldout_l1(network, judge, SftOptions(), torch.device("cpu"))
    both = heldout_l1(network, judge, SftOptions(hidden=0.25), torch.device("cpu"))
    assert set(plain) == {"l1"} and both["l1"] == plain["l1"] and both["hidden"] != both["l1"]
    assert judged({"l1": 0.2}, 0.0) == 0.2
    assert judged({"l1": 0.2, "hidden": 0.4}, 0.25) == pytest.approx(0.25)
