"""A sweep as tables on disk: one row a step, and back."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from edream.calibration.windows import Sequences

STEPS, SETS = "steps.parquet", "sets.parquet"


def to_tables(made: Sequences, names: Sequence[str], joints: Sequence[str], values: np.ndarray) -> dict[str, Any]:
    """Sequences as two tables: `sets` with the parameters of each simulated window, `steps` with one row a step.

    The next state of a step is the next row of the same window. State and command are lists over the joints; 32-bit, since
    surrogates read no more.
    """
    n, t, j = made.position.shape
    sets = {
        "set": pa.array(made.which[:, 0], pa.int32()),
        "window": pa.array(made.which[:, 1], pa.int32()),
        **{name: pa.array(values[:, i]) for i, name in enumerate(names)},
        "unit": _lists(made.unit, pa.float64()),
        "factors": _lists(made.factors, pa.float64()),
    }
    steps = {
        "set": pa.array(np.repeat(made.which[:, 0], t), pa.int32()),
        "window": pa.array(np.repeat(made.which[:, 1], t), pa.int32()),
        "step": pa.array(np.tile(np.arange(t), n), pa.int16()),
        "position": _lists(made.position.reshape(n * t, j), pa.float32()),
        "velocity": _lists(made.velocity.reshape(n * t, j), pa.float32()),
        "command": _lists(made.command.reshape(n * t, j), pa.float32()),
        "dt": pa.array(made.dt.ravel(), pa.float32()),
        "enabled": pa.array(made.enabled.ravel() > 0.5),
    }
    return {SETS: pa.table(sets), STEPS: pa.table(steps)}


def from_tables(bundle: Mapping[str, Any]) -> Sequences:
    """Inverse of `to_tables`."""
    sets, steps = bundle[SETS], bundle[STEPS]
    n = sets.num_rows
    t = steps.num_rows // max(1, n)

    def cube(name: str) -> np.ndarray:
        flat = _numbers(steps[name])
        return flat.reshape(n, t, -1)

    return Sequences(
        _numbers(sets["unit"]).reshape(n, -1),
        _numbers(sets["factors"]).reshape(n, -1),
        cube("position"),
        cube("velocity"),
        cube("command"),
        steps["dt"].to_numpy().reshape(n, t).astype(float),
        steps["enabled"].to_numpy(zero_copy_only=False).reshape(n, t).astype(float),
        np.stack([sets["set"].to_numpy(), sets["window"].to_numpy()], axis=1),
    )


def _lists(rows: np.ndarray, kind: pa.DataType) -> pa.FixedSizeListArray:
    return (
        pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(rows).ravel(), kind), rows.shape[1])
        if rows.shape[1]
        else pa.nulls(len(rows), pa.list_(kind))
    )


def _numbers(column: pa.ChunkedArray) -> np.ndarray:
    whole = column.combine_chunks()
    whole = whole if isinstance(whole, pa.Array) else pa.concat_arrays(whole.chunks)
    return np.asarray(whole.flatten(), dtype=float)
