"""What the stages of `edream train-policy` share: demonstrations, trials in a world, ranking, rates."""
