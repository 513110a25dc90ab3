"""What is unknown about a simulator, and the box it is searched in."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from edream.core.errors import EdreamError, unknown_name


@dataclass(frozen=True)
class Parameter:
    """One unknown number of a simulator.

    Attributes:
        name: full name, `effect.quantity[target]`, such as `coulomb.torque[elbow_flex]`.
        unit: SI unit as printed, such as "N m".
        low: smallest value searched.
        high: largest value searched.
        start: where a fit begins; with a prior, its centre.
        absent: the value at which the effect is not there, or None where there is no such value.
        spread: standard deviation of the prior, in the parameter's unit, or as a factor's natural logarithm where
            `scale` is "log"; infinite where nothing is known beforehand.
        guessed: whether `start` is only a place to begin, since the model says nothing of this number.
        scale: "log" for positive quantities searched by their ratio (gains), else "linear".
        attained: whether its box ends where nature does, as a share of all does, so that it may well lie there.
    """

    name: str
    unit: str
    low: float
    high: float
    start: float
    absent: float | None = None
    spread: float = math.inf
    scale: Literal["linear", "log"] = "linear"
    guessed: bool = False
    attained: bool = False

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise EdreamError(f"Parameter {self.name!r}: its low bound {self.low} must be below its high bound {self.high}.")
        if self.scale == "log" and self.low <= 0.0:
            raise EdreamError(f"Parameter {self.name!r}: a log scale needs a low bound above 0, not {self.low}.")
        if not self.low <= self.start <= self.high:
            box = f"{self.low} to {self.high} {self.unit}"
            raise EdreamError(f"Parameter {self.name!r}: its start {self.start} lies outside {box}.")


@dataclass(frozen=True)
class ParameterSpace:
    """An ordered set of parameters, with the map to and from the unit box that searches run in."""

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        names = self.names
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise EdreamError(f"Parameter named twice: {', '.join(twice)}. Each name must stand once.")

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    def start(self) -> Float[np.ndarray, "P"]:
        """The values that a fit begins at."""
        return np.array([parameter.start for parameter in self.parameters])

    def to_unit(self, values: Float[np.ndarray, "*N P"]) -> Float[np.ndarray, "*N P"]:
        """Values in their units -> the unit box [0, 1]^P (linear or logarithmic, by each parameter's scale)."""
        low, high, is_log = self._bounds()
        inner = np.where(is_log, np.log(np.where(is_log, values, 1.0)), values)
        return (inner - low) / (high - low)

    def from_unit(self, unit: Float[np.ndarray, "*N P"]) -> Float[np.ndarray, "*N P"]:
        """The unit box [0, 1]^P -> values in their units; inverse of `to_unit`."""
        low, high, is_log = self._bounds()
        inner = low + np.asarray(unit) * (high - low)
        return np.where(is_log, np.exp(np.where(is_log, inner, 0.0)), inner)

    def unit_prior(self) -> tuple[Float[np.ndarray, "P"], Float[np.ndarray, "P"]]:
        """Centre and standard deviation of the priors in the unit box; infinite deviation where there is none."""
        low, high, _ = self._bounds()
        spread = np.array([parameter.spread for parameter in self.parameters])
        return self.to_unit(self.start()), spread / (high - low)

    def subset(self, names: Sequence[str]) -> "ParameterSpace":
        """The named parameters, in the order given.

        Raises:
            EdreamError: a name is not in this space.
        """
        by_name = {parameter.name: parameter for parameter in self.parameters}
        for name in names:
            if name not in by_name:
                raise unknown_name("parameter", name, by_name)
        return ParameterSpace(tuple(by_name[name] for name in names))

    def mapping(self, values: Float[np.ndarray, "P"]) -> dict[str, float]:
        """A value vector as a plain mapping from name to number."""
        return {name: float(value) for name, value in zip(self.names, values, strict=True)}

    def vector(self, values: Mapping[str, float]) -> Float[np.ndarray, "P"]:
        """A mapping from name to number as a value vector in this space's order."""
        return np.array([values[name] for name in self.names])

    def _bounds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        is_log = np.array([parameter.scale == "log" for parameter in self.parameters], dtype=bool)
        low = np.array([math.log(p.low) if p.scale == "log" else p.low for p in self.parameters])
        high = np.array([math.log(p.high) if p.scale == "log" else p.high for p in self.parameters])
        return low, high, is_log


def targets_in(name: str) -> frozenset[str]:
    """The joints (or bodies) in a parameter's full name, `effect.quantity[a+b]` or, of a pair, `effect.quantity[a<-b]`."""
    return frozenset(name.partition("[")[2].rstrip("]").replace("<-", "+").split("+"))
