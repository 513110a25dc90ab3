"""Group-relative policy optimisation over whole trajectories."""

import torch
from jaxtyping import Float
from torch import Tensor

from edream.learn.preference import Judged, Preference, PreferenceOptions


class Grpo(Preference):
    """Trials that went better than the others of their start become likelier, the worse ones less so, within a trust region.

        L = -mean min(s A, clip(s, 1 - c, 1 + c) A),      s = exp(r / n)

    The ratio is that of a trajectory, per executed number n; a product over hundreds of steps would be 0 or infinite.
    Source: Shao et al., arXiv:2402.03300; the per-length ratio: Zheng et al., arXiv:2507.18071.
    """

    name = "grpo"
    summary = "Group-relative policy optimisation with a clipped, per-length trajectory ratio."
    pairs = False

    def loss(self, judged: Judged, options: PreferenceOptions) -> Float[Tensor, ""]:
        s = torch.exp((judged.ratio / judged.size).clamp(-5.0, 5.0))
        held = s.clamp(1.0 - options.clip, 1.0 + options.clip)
        return -torch.minimum(s * judged.advantage, held * judged.advantage).mean()


ENTRY = Grpo()
