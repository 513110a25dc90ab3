"""A step of the natural policy gradient, learned by regression."""

from jaxtyping import Float
from torch import Tensor

from edream.learn.preference import Judged, Preference, PreferenceOptions


class Natural(Preference):
    """The way that chance led a trial is gone where it did better than others of its start, and the other way where it did worse.

        L = mean |mu - mu_ref - s A (a - mu_ref)|^2 / (2 b^2 n),  less what does not depend on mu

    For a normal policy A (a - mu_ref) is the natural gradient of what a trial is worth; the network takes the step that fits all of
    them best. What chance did not touch stays where it was, and what failed is not fled from any farther than chance had led there:
    every decision, of trials that failed too, says where its mean is to be.
    Source: Kakade, A natural policy gradient, NeurIPS 2001; regression on it: Peters & Schaal, Natural actor-critic, 2008.
    """

    name = "natural"
    summary = "A step of the natural policy gradient, by regression on what the policy did before and on what chance added to it."
    looks_at = "decisions"
    batch = 128
    region = True

    def steepness(self, judged: Judged, options: PreferenceOptions) -> float:
        return max(float((judged.chance / judged.size).mean()), 1e-6)

    def loss(self, judged: Judged, options: PreferenceOptions) -> Float[Tensor, ""]:
        return ((judged.moved - 2.0 * options.step * judged.advantage * judged.towards) / (2.0 * judged.size)).mean()


ENTRY = Natural()
