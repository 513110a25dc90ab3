"""Trajectory preference optimisation, anchored on the chosen trajectory."""

from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import logsigmoid

from edream.learn.preference import Judged, Preference, PreferenceOptions


class Tpo(Preference):
    """The likelier the better of two trials of one start, against the policy that training began with.

        L = -log sigma(beta [r(w) - r(l)]) + alpha beta sum |a_w - mu| / b,      r(z) = log pi(z) - log pi_ref(z)

    The second term is the chosen trajectory's error in the same units. Without it both trajectories become less likely, and the
    policy forgets what it could do. Source of the first term: Zhang et al., arXiv:2411.19309 (GRAPE), after Rafailov et al.,
    arXiv:2305.18290.
    """

    name = "tpo"
    summary = "Trajectory preference optimisation with the chosen trajectory's L1 error as anchor."
    looks_at = "pairs"

    def steepness(self, judged: Judged, options: PreferenceOptions) -> float:
        return options.beta * float(judged.size.mean())

    def loss(self, judged: Judged, options: PreferenceOptions) -> Float[Tensor, ""]:
        gap = judged.ratio[judged.chosen] - judged.ratio[judged.rejected]
        anchor = options.alpha * options.beta * judged.error[judged.chosen]
        return (anchor - logsigmoid(options.beta * gap)).mean()


ENTRY = Tpo()
