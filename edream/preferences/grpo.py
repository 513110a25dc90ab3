"""Group-relative policy optimisation, decision by decision."""

import torch
from jaxtyping import Float
from torch import Tensor

from edream.learn.preference import Judged, Preference, PreferenceOptions


class Grpo(Preference):
    """Decisions of trials that went better than others of their start become likelier, the others less so, within a trust region.

        L = -mean min(s A, clip(s, 1 - c, 1 + c) A),      s = exp(r / n)

    A is how much better its trial did, r the log-ratio of the n numbers that a decision led to; a product over dozens of them would
    be 0 or infinite. Without the region what failed is fled from in whatever direction, far beyond where the trials tell anything.
    Source: Shao et al., arXiv:2402.03300, a decision in place of a word; the ratio by length: Zheng et al., arXiv:2507.18071.
    """

    name = "grpo"
    summary = "Group-relative policy optimisation with a clipped ratio, decision by decision."
    looks_at = "decisions"
    batch = 64
    region = True

    def loss(self, judged: Judged, options: PreferenceOptions) -> Float[Tensor, ""]:
        s = torch.exp((judged.ratio / judged.size).clamp(-5.0, 5.0))
        held = s.clamp(1.0 - options.clip, 1.0 + options.clip)
        return -torch.minimum(s * judged.advantage, held * judged.advantage).mean()


ENTRY = Grpo()
