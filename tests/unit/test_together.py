"""Training in several processes, kept latents, gradient checkpointing, narrow numbers: flags that do what they say."""

import json
import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest
import torch

from edream.calibration.settings import RobotSettings
from edream.core.errors import EdreamError
from edream.learn import ranks
from edream.learn.checkpoint import weights_digest
from edream.learn.device import acting_on, device_of
from edream.learn.training import Schedule, new_state
from edream.practice.demonstrations import ChunkBatches
from edream.practice.options import PolicyOptions, SftOptions
from edream.stages.dream import Trainer
from edream.stages.sft import SftConfig
from edream.stages.sft import Trainer as SftTrainer
from edream.vision.batches import Batches, KeptLatents
from edream.vision.clips import images as as_tensor
from edream.vision.dreamer import Part, encoded, new_codec
from edream.vision.variants import DreamOptions, new_model, variants
from tests.dreams import small_scenes
from tests.toy_world import about, demonstrated

TINY = DreamOptions(
    codec=Part("pixel_unshuffle", {"factor": 4}),
    denoiser=Part("unet", {"widths": (16, 24), "heads": 2}),
    objective=Part("bridge"),
    train=Schedule(steps=4, rate=4e-3, warmup=2, average=0.9),
    frames=6,
    train_frames=4,
    batch=4,
    overlap=2,
    device="cpu",  # whose bytes are compared, where there is a GPU, too
)


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)


def trainer(folder: Path, options: DreamOptions) -> Trainer:
    folder.mkdir(parents=True, exist_ok=True)
    return Trainer(small_scenes(folder / "images"), None, {}, options, 0, variants(options, ("real", "sim", "crop")))


def threads(patience: float = 5.0) -> list[str]:
    """Threads of this process that gloo has begun and that stay; one that ends with them may be aborted.

    Empty where /proc does not tell. One that was joined is still listed for a moment, which is long on a busy machine.
    """
    until = monotonic() + patience
    while (left := [name for name in _names() if "gloo" in name]) and monotonic() < until:
        sleep(0.05)
    return left


def _names() -> list[str]:
    names = []
    for one in Path("/proc/self/task").glob("*"):
        with suppress(FileNotFoundError, ProcessLookupError):  # it has ended since it was listed
            names.append((one / "comm").read_text().strip())
    return names


def _one_of_two(number: int, folder: Path) -> None:
    """One process: leads or follows the same training twice, then writes down what it has."""
    torch.set_num_threads(1)
    ranks.meet("gloo", init_method=f"file://{folder}/meet", rank=number, world_size=2)
    digests = []
    for turn in range(2):
        one = trainer(folder / f"{number}-{turn}", TINY)
        if number == 0:
            state = one.begin(0)
            for first, last in ((0, 2), (2, 4)):
                ranks.lead((0, first, last), state)
                state, _ = one.piece(state, first, last)
            torch.distributed.broadcast(torch.tensor([ranks.STOP, 0, 0]), 0)
        else:
            for which, first, last in ranks.orders():
                state, _ = one.piece(ranks.followed(one.begin(which)), first, last)
        digests.append(weights_digest(state))
    shares = [batch.clip.real.shape[0] for batch in [Batches(one.scenes, TINY, one.variants[0], 0).at(0)]]
    torch.distributed.destroy_process_group()
    (folder / f"{number}.json").write_text(json.dumps({"digests": digests, "shares": shares, "left": threads()}))


def test_two_processes_train_one_network_and_give_the_same_bytes_each_time(tmp_path: Path) -> None:
    torch.multiprocessing.spawn(_one_of_two, (tmp_path,), nprocs=2)
    one, other = (json.loads((tmp_path / f"{number}.json").read_text()) for number in range(2))
    assert len({*one["digests"], *other["digests"]}) == 1, "both have the same weights, and have them again"
    assert one["shares"] == other["shares"] == [2], "each has half of the batch"
    assert not one["left"] + other["left"], "no thread outlives the group"
    alone = trainer(tmp_path / "alone", TINY)
    state, _ = alone.piece(alone.begin(0), 0, 4)
    assert weights_digest(state) != one["digests"][0], "chances are each process' own, so the number of processes counts"


def sft(batch: int = 8) -> SftTrainer:
    """The training of a policy on two small demonstrations."""
    demos = (demonstrated(1), demonstrated(2))
    known, options = about(list(demos)), SftOptions(Schedule(steps=4, rate=3e-3, average=0.9), batch=batch, checkpoint=2)
    batches = ChunkBatches(demos, known, batch, 0)
    config = SftConfig(RobotSettings(Path("robot.xml")), PolicyOptions(), options, 0)
    return SftTrainer(config, known, known.network(seed=0), demos, batches, batches, ())


def _policy_of_two(number: int, folder: Path) -> None:
    """One process: both train a policy, piece by piece; then the first one alone another, which the second does not have."""
    torch.set_num_threads(1)
    ranks.meet("gloo", init_method=f"file://{folder}/meet", rank=number, world_size=2)
    one, other = sft(), sft(batch=4)
    state, along, alone = new_state(one.network), [], None
    if number == 0:
        for first, last in ((0, 2), (2, 4)):
            along.append(ranks.led((one.number, first, last), state))
            state, _ = one.piece(state, first, last, along[-1])
        own = new_state(other.network)
        along.append(ranks.led((other.number, 0, 2), own))
        alone = weights_digest(other.piece(own, 0, 2, along[-1])[0])
        torch.distributed.broadcast(torch.tensor([ranks.STOP, 0, 0]), 0)
    else:
        for _, first, last in ranks.orders(one.number):
            state, _ = one.piece(ranks.followed(new_state(one.network)), first, last, together=True)
    torch.distributed.destroy_process_group()
    told = {"digest": weights_digest(state), "along": along, "alone": alone, "left": threads()}
    (folder / f"{number}.json").write_text(json.dumps(told))


def test_two_processes_train_one_policy_and_the_first_one_alone_what_the_other_does_not_have(tmp_path: Path) -> None:
    torch.multiprocessing.spawn(_policy_of_two, (tmp_path,), nprocs=2)
    lead, follower = (json.loads((tmp_path / f"{number}.json").read_text()) for number in range(2))
    assert lead["digest"] == follower["digest"], "both have the same weights"
    assert lead["along"] == [True, True, False]
    assert not lead["left"] + follower["left"], "no thread outlives the group"
    for batch, steps, digest, same in ((8, 4, lead["digest"], False), (4, 2, lead["alone"], True)):
        here = sft(batch)
        state, _ = here.piece(new_state(here.network), 0, steps, together=False)
        assert (weights_digest(state) == digest) == same, "what two train has chances of its own; what one trains is as ever"


def test_two_processes_see_the_two_halves_of_a_batch_of_demonstrations() -> None:
    whole, halves = sft().batches, [replace(sft().batches, part=(own, 2)) for own in range(2)]
    actions = [batches.at(3)[1] for batches in (whole, *halves)]
    assert torch.equal(torch.cat([actions[0][0::2], actions[0][1::2]]), torch.cat(actions[1:]))


def test_a_batch_that_cannot_be_shared_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ranks, "world", lambda: 3)
    with pytest.raises(EdreamError, match="multiple of 3"):
        Batches(small_scenes(tmp_path), TINY, variants(TINY, ("real",))[0], 0).at(0)


def test_kept_latents_train_as_the_images_do(tmp_path: Path) -> None:
    options = replace(TINY, codec=Part("kl_vae", {"widths": (32, 32)}))
    scenes, codec = small_scenes(tmp_path / "images"), new_codec(options.codec, 0).eval()
    whole = [encoded(codec, as_tensor(one["real"])).numpy() for one in scenes.layers]
    places = [encoded(codec, as_tensor(one)[None]).numpy() for one in scenes.references]
    (tmp_path / "kept").mkdir()
    kept = KeptLatents.gather(({"real": r, "reference": p} for r, p in zip(whole, places, strict=True)), tmp_path / "kept")
    found = []
    for latents in (None, kept):
        one = Trainer(scenes, latents, {}, options, 0, variants(options, ("real", "sim", "crop")))
        state, losses = one.piece(one.begin(0), 0, 2)
        found.append((state, losses))
    assert np.allclose(found[0][1], found[1][1], rtol=1e-4)
    assert all(np.allclose(found[0][0][name], found[1][0][name], atol=1e-3) for name in found[0][0])


@pytest.mark.parametrize("kind", ["unet", "svd"])
def test_gradient_checkpointing_keeps_less_and_gives_the_same_gradients(kind: str, tmp_path: Path) -> None:
    small = {"unet": {"widths": (16, 24), "heads": 2}, "svd": {"widths": (32, 32), "cross": 8, "heads": 2}}[kind]
    objective = Part("edm") if kind == "svd" else Part("bridge")
    batch = Batches(small_scenes(tmp_path), TINY, variants(TINY, ("real",))[0], 0).at(0)
    found, kept = [], []
    for save in (False, True):
        options = replace(TINY, denoiser=Part(kind, small | {"save_memory": save}), objective=objective)
        model = new_model(options, variants(options, ("real",))[0], 0)
        with torch.no_grad():
            for tensor in model.denoiser.parameters():
                tensor.add_(0.02 * torch.randn(tensor.shape, generator=torch.Generator().manual_seed(1)))
        sizes: list[int] = []

        def count(tensor: torch.Tensor, sizes: list[int] = sizes) -> torch.Tensor:
            sizes.append(tensor.numel())
            return tensor

        with torch.autograd.graph.saved_tensors_hooks(count, lambda tensor: tensor):
            model.train()
            loss = model.loss(batch.clip, batch.known, torch.Generator().manual_seed(0))
        kept.append(sum(sizes))
        loss.backward()
        found.append(torch.cat([p.grad.flatten() for p in model.denoiser.parameters() if p.grad is not None]))
    assert torch.allclose(found[0], found[1], atol=1e-5) and found[0].any()
    assert kept[1] < 0.6 * kept[0]


def test_narrow_numbers_are_used_inside_and_loss_and_state_stay_wide(tmp_path: Path) -> None:
    seen: set[torch.dtype] = set()
    options = replace(TINY, train=replace(TINY.train, precision="bfloat16"))
    one = trainer(tmp_path, options)
    begun = one.begin(0)
    assert one._at_work is not None
    model = one._at_work[1]
    hook = model.denoiser.enter.register_forward_hook(lambda module, given, out: seen.add(out.dtype))
    state, losses = one.piece(begun, 0, 2)
    hook.remove()
    assert seen == {torch.bfloat16} and np.isfinite(losses).all()
    assert {value.dtype for value in state.values()} == {np.dtype(np.float32)}
    wide = trainer(tmp_path / "wide", TINY)
    other, same = wide.piece(wide.begin(0), 0, 2)
    assert not np.array_equal(losses, same) and np.allclose(losses, same, rtol=0.1)
    assert weights_digest(state) != weights_digest(other)


def test_a_gpu_is_asked_to_repeat_its_bytes_before_its_first_product(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CUBLAS_WORKSPACE_CONFIG", raising=False)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert device_of("cpu", "dream.device").type == "cpu" and "CUBLAS_WORKSPACE_CONFIG" not in os.environ
    assert device_of("auto", "dream.device").type == "cuda", (
        "torch refuses products there under deterministic algorithms without it"
    )
    assert os.environ.pop("CUBLAS_WORKSPACE_CONFIG") == ":4096:8"
    assert [acting_on(asked) for asked in ("auto", "cpu", "cuda")] == ["cpu", "cpu", "cuda"], "small networks act on the processor"


@pytest.mark.parametrize("asked", [False, True])
def test_the_loss_of_a_policy_is_compiled_where_that_is_asked_for(asked: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    compiled: list[torch.nn.Module] = []
    monkeypatch.setattr(torch.nn.Module, "compile", lambda self: compiled.append(self))
    one = sft()
    one = replace(one, config=replace(one.config, sft=replace(one.config.sft, compile=asked)))
    state, _ = one.piece(new_state(one.network), 0, 1, together=False)
    one.piece(state, 1, 2, together=False)
    assert compiled == ([one.lesson] if asked else []), "once, however many pieces"


def test_a_gpu_that_is_asked_for_and_not_there_is_a_sentence() -> None:
    if torch.cuda.is_available():
        pytest.skip("there is one")
    with pytest.raises(EdreamError, match=r"dream\.device is cuda, .* no GPU"):
        device_of("cuda", "dream.device")
