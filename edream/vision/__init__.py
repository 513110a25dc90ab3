"""From renderings to video that looks real: what the stages of `edream dream` share."""
