"""What sweep, surrogate and fit share: parameters, loss, the split into training and held-out motions, what a fit is worth."""
