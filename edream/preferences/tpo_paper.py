"""Trajectory preference optimisation as published, without an anchor."""

from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import logsigmoid

from edream.learn.preference import Judged, Preference, PreferenceOptions


class TpoPaper(Preference):
    """The likelier the better of two trials of one start: L = -log sigma(beta [r(w) - r(l)]). Alpha counts for nothing here."""

    name = "tpo_paper"
    summary = "Trajectory preference optimisation as published: no anchor."
    looks_at = "pairs"

    def steepness(self, judged: Judged, options: PreferenceOptions) -> float:
        return options.beta * float(judged.size.mean())

    def loss(self, judged: Judged, options: PreferenceOptions) -> Float[Tensor, ""]:
        gap = judged.ratio[judged.chosen] - judged.ratio[judged.rejected]
        return -logsigmoid(options.beta * gap).mean()


ENTRY = TpoPaper()
