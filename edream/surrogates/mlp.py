"""The paper's surrogate: a three-layer perceptron from parameters, command and state to the next state."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from edream.calibration.surrogate import Surrogate
from edream.calibration.windows import Sequences
from edream.core.errors import EdreamError, require
from edream.learn.determinism import deterministic

DEFAULTS = {"hidden": 96, "members": 2, "epochs": 8, "horizon": 8, "batch": 512, "rate": 3e-3, "velocity_weight": 0.1}


class Mlp(Surrogate):
    """Next state from parameters, command and state, as the change of state.

        S_t = S_{t-1} + M_theta(a_{t-1}, a_{t-2}, S_{t-1}; parameters, factors, dt, torque on)

    Three layers, SiLU, inputs and outputs normalised, an ensemble whose members differ in their first weights and in the order of
    their lessons. Trained over several steps in a row (MSE at each), because that is how it is used. State: position and velocity.
    """

    name = "mlp"
    summary = "three-layer perceptron on (parameters, command, state), trained over several steps, as an ensemble"

    def __init__(self, tensors: Mapping[str, torch.Tensor] | None = None) -> None:
        self._tensors = dict(tensors or {})

    def fit(self, sweep: Sequences, options: Mapping[str, Any], seed: int) -> "Mlp":
        for name in options:
            if name not in DEFAULTS:
                raise EdreamError(f"Surrogate mlp has no option {name!r}; it has {', '.join(DEFAULTS)}.")
        chosen = DEFAULTS | dict(options)
        for name, value in chosen.items():
            least = 0 if name == "velocity_weight" else 1e-9 if name == "rate" else 1
            require(value >= least, f"surrogate.options.{name}", value, f"{least:g} or more")
        with deterministic():
            tensors = _norms(sweep) | _first_weights(sweep, int(chosen["hidden"]), int(chosen["members"]), seed)
            return Mlp(_train(tensors, sweep, chosen, seed))

    def predict(self, values: torch.Tensor, windows: Sequences) -> torch.Tensor:
        rows = _tensors(windows)
        unit = values.expand(len(windows), -1) if values.ndim == 1 else values
        return _unroll(self._tensors, unit.to(torch.float32), rows, windows.position.shape[1] - 1)[0].mean(dim=0)

    def trust(self, values: Float[np.ndarray, "N P"], windows: Sequences) -> Float[np.ndarray, "N"]:
        out = []
        with torch.no_grad(), deterministic():
            rows = _tensors(windows)
            for one in np.atleast_2d(values):
                unit = torch.tensor(one, dtype=torch.float32).expand(len(windows), -1)
                members = _unroll(self._tensors, unit, rows, windows.position.shape[1] - 1)[0]
                out.append(float(members.std(dim=0).square().mean().sqrt()))
        return np.array(out)

    def weights(self) -> Mapping[str, np.ndarray]:
        return {name: tensor.detach().numpy() for name, tensor in self._tensors.items()}

    def load(self, weights: Mapping[str, np.ndarray]) -> "Mlp":
        return Mlp({name: torch.tensor(array) for name, array in weights.items()})

    def errors(self, sweep: Sequences) -> dict[str, float]:
        with torch.no_grad(), deterministic():
            rows = _tensors(sweep)
            steps = sweep.position.shape[1] - 1
            whole = _unroll(self._tensors, rows["unit"], rows, steps)[0].mean(dim=0) - rows["position"]
            one = [
                _step(self._tensors, rows["unit"], rows, t, rows["position"][:, t], rows["velocity"][:, t])[0].mean(dim=0)
                for t in range(steps)
            ]
            single = torch.stack(one, dim=1) - rows["position"][:, 1:]
            still = rows["position"][:, :1] - rows["position"]
            change = rows["position"][:, 1:] - rows["position"][:, :-1]
        rms = {
            "one_step_rad": single,
            "window_rad": whole[:, 1:],
            "standing_still_one_step_rad": change,
            "standing_still_window_rad": still[:, 1:],
        }
        return {name: float(error.square().mean().sqrt()) for name, error in rms.items()} | {"window_rows": float(steps)}


def _tensors(windows: Sequences) -> dict[str, torch.Tensor]:
    names = ("unit", "factors", "position", "velocity", "command", "dt", "enabled")
    return {name: torch.tensor(getattr(windows, name), dtype=torch.float32) for name in names}


def _features(
    unit: torch.Tensor, rows: Mapping[str, torch.Tensor], t: int, position: torch.Tensor, velocity: torch.Tensor
) -> torch.Tensor:
    shape = (*position.shape[:-1], -1)
    command, last = rows["command"][:, t], rows["command"][:, max(0, t - 1)]
    shared = [unit, rows["factors"], rows["dt"][:, t, None], rows["enabled"][:, t, None], command - last]
    parts = [
        position,
        velocity,
        command - position,
        *(part.expand(shape) if part.shape[-1] else part.expand(*position.shape[:-1], 0) for part in shared),
    ]
    return torch.cat(parts, dim=-1)


def _step(
    net: Mapping[str, torch.Tensor],
    unit: torch.Tensor,
    rows: Mapping[str, torch.Tensor],
    t: int,
    position: torch.Tensor,
    velocity: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """One step of every member, from a state of each or one for all: (E, N, J) twice."""
    members = net["w0"].shape[0]
    if position.ndim == 2:
        position, velocity = position.expand(members, -1, -1), velocity.expand(members, -1, -1)
    x = (_features(unit, rows, t, position, velocity) - net["in_mean"]) / net["in_scale"]  # E N F
    x = torch.nn.functional.silu(torch.baddbmm(net["b0"], x, net["w0"]))
    x = torch.nn.functional.silu(torch.baddbmm(net["b1"], x, net["w1"]))
    change = torch.baddbmm(net["b2"], x, net["w2"]) * net["out_scale"]  # E N 2J
    joints = position.shape[-1]
    # what a moving joint does anyway; the network learns the rest
    drift = velocity * rows["dt"][:, t, None]
    return position + drift + change[..., :joints], velocity + change[..., joints:]


def _unroll(
    net: Mapping[str, torch.Tensor], unit: torch.Tensor, rows: Mapping[str, torch.Tensor], steps: int
) -> tuple[torch.Tensor, torch.Tensor]:
    members = net["w0"].shape[0]
    position = rows["position"][:, 0].expand(members, -1, -1)
    velocity = rows["velocity"][:, 0].expand(members, -1, -1)
    positions, velocities = [position], [velocity]
    for t in range(steps):
        position, velocity = _step(net, unit, rows, t, position, velocity)
        positions.append(position)
        velocities.append(velocity)
    return torch.stack(positions, dim=2), torch.stack(velocities, dim=2)  # E N T J


def _norms(sweep: Sequences) -> dict[str, torch.Tensor]:
    rows = _tensors(sweep)
    steps = sweep.position.shape[1] - 1
    every = torch.cat([_features(rows["unit"], rows, t, rows["position"][:, t], rows["velocity"][:, t]) for t in range(steps)])
    moved = rows["position"][:, 1:] - rows["position"][:, :-1] - rows["velocity"][:, :-1] * rows["dt"][:, :-1, None]
    sped = rows["velocity"][:, 1:] - rows["velocity"][:, :-1]
    change = torch.cat([moved, sped], dim=-1).flatten(0, 1)
    scale = every.std(dim=0)
    return {
        "in_mean": every.mean(dim=0),
        "in_scale": torch.where(scale > 1e-6, scale, torch.ones_like(scale)),
        "out_scale": change.std(dim=0).clamp_min(1e-6),
    }


def _first_weights(sweep: Sequences, hidden: int, members: int, seed: int) -> dict[str, torch.Tensor]:
    joints = sweep.position.shape[2]
    inputs = 4 * joints + 2 + sweep.unit.shape[1] + sweep.factors.shape[1]
    generator = torch.Generator().manual_seed(seed)
    sizes = [inputs, hidden, hidden, 2 * joints]
    net = {}
    for layer, (a, b) in enumerate(pairwise(sizes)):
        gain = 0.1 if layer == 2 else 1.0
        net[f"w{layer}"] = torch.randn(members, a, b, generator=generator) * gain / a**0.5
        net[f"b{layer}"] = torch.zeros(members, 1, b)
    return net


def _train(net: dict[str, torch.Tensor], sweep: Sequences, options: Mapping[str, Any], seed: int) -> dict[str, torch.Tensor]:
    learned = [net[name].requires_grad_() for name in ("w0", "b0", "w1", "b1", "w2", "b2")]
    adam = torch.optim.Adam(learned, lr=float(options["rate"]))
    rows, (count, length) = _tensors(sweep), sweep.position.shape[:2]
    joints = sweep.position.shape[2]
    epochs, batch = int(options["epochs"]), int(options["batch"])
    generator = torch.Generator().manual_seed(seed + 1)
    # first one step at a time, then longer and longer
    horizons = [
        max(1, min(length - 1, round(int(options["horizon"]) * max(0.0, (e - epochs // 3) / max(1, epochs - 1 - epochs // 3)))))
        for e in range(epochs)
    ]
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(
        adam, sum(-(-count * ((length - 1) // h) // batch) for h in horizons), float(options["rate"]) * 0.02
    )
    weight = torch.cat([torch.ones(joints), torch.full((joints,), float(options["velocity_weight"]))])
    for horizon in horizons:
        pieces = _pieces(rows, length, horizon, generator)
        order = torch.randperm(len(pieces["unit"]), generator=generator)
        for chosen in order.split(batch):
            part = {name: tensor[chosen] for name, tensor in pieces.items()}
            position, velocity = _unroll(net, part["unit"], part, horizon)
            truth = torch.cat([part["position"], part["velocity"]], dim=-1)
            error = (torch.cat([position, velocity], dim=-1) - truth)[:, :, 1:] / net["out_scale"]
            adam.zero_grad()
            (error.square() * weight).mean().mul(len(net["w0"])).backward()
            torch.nn.utils.clip_grad_norm_(learned, 10.0)
            adam.step()
            schedule.step()
    return {name: tensor.detach() for name, tensor in net.items()}


def _pieces(rows: Mapping[str, torch.Tensor], length: int, horizon: int, generator: torch.Generator) -> dict[str, torch.Tensor]:
    """Every window cut into stretches of `horizon` steps from a random offset."""
    count = (length - 1) // horizon
    offset = int(torch.randint(0, length - count * horizon, (1,), generator=generator))
    starts = [offset + i * horizon for i in range(count)]
    cut = {
        name: torch.cat([rows[name][:, a : a + horizon + 1] for a in starts])
        for name in ("position", "velocity", "command", "dt", "enabled")
    }
    return cut | {name: rows[name].repeat(count, 1) for name in ("unit", "factors")}


ENTRY = Mlp()
