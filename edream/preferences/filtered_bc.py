"""Behaviour cloning of the trials that went well."""

from jaxtyping import Float
from torch import Tensor

from edream.learn.preference import Judged, Preference, PreferenceOptions


class FilteredBc(Preference):
    """Imitate what succeeded, and nothing else: the mean error of trajectories worth imitating; 0 where a batch holds none."""

    name = "filtered_bc"
    summary = "Imitation of the trials that succeeded."
    looks_at = "starts"

    def loss(self, judged: Judged, options: PreferenceOptions) -> Float[Tensor, ""]:
        weight = judged.good.to(judged.error.dtype)
        return (weight * judged.error / judged.size).sum() / weight.sum().clamp(min=1.0)


ENTRY = FilteredBc()
