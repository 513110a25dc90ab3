"""How each sort of value lies on disk, and what of it counts: write, read and digest by file suffix.

A digest is *logical*: it says whether two files mean the same, whichever library version wrote them.
"""

import hashlib
import json
import math
import os
import re
import signal
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

TEXT = frozenset({".xml", ".py", ".csv", ".html", ".txt", ".md", ".yaml"})
CLOCK = re.compile(rb"<time>[^<]*</time>")
_passed: Counter[str] = Counter()


def write(value: Any, path: Path) -> None:
    """Write a value in the form that its file's suffix names, and flush it to the disk.

    Raises:
        OSError: the disk is full or may not be written.
        TypeError, ValueError: the value does not suit the suffix (a bug in a stage).
    """
    with open(path, "wb") as file:
        if path.suffix == ".parquet":
            import pyarrow.parquet as pq

            pq.write_table(value.replace_schema_metadata(None), file, compression="zstd", version="2.6", row_group_size=1 << 18)
        elif path.suffix == ".json":
            file.write(canonical(value))
        elif path.suffix == ".safetensors":
            from safetensors.numpy import save

            file.write(save({name: np.ascontiguousarray(array) for name, array in sorted(value.items())}))
        else:
            file.write(value.encode() if path.suffix in TEXT else value)
        file.flush()
        failpoint("written")
        os.fsync(file.fileno())


def failpoint(name: str) -> None:
    """Kill this process where `EDREAM_FAILPOINT` says so ("rename" or, at the third time, "rename:3"); for fault tests."""
    wanted = os.environ.get("EDREAM_FAILPOINT")
    if wanted:
        _passed[name] += 1
        if wanted in (name, f"{name}:{_passed[name]}"):
            os.kill(os.getpid(), signal.SIGKILL)


def read(path: Path) -> Any:
    """Read a value back; inverse of `write`."""
    if path.suffix == ".parquet":
        import pyarrow.parquet as pq

        return pq.ParquetFile(path).read()  # read_table takes folders named a=b in the path for columns
    if path.suffix == ".json":
        return json.loads(path.read_bytes())
    if path.suffix == ".safetensors":
        from safetensors.numpy import load_file

        return load_file(path)
    return path.read_bytes().decode() if path.suffix in TEXT else path.read_bytes()


def digest(path: Path) -> str:
    """Logical digest of a written file: tables and arrays by names, types and values, everything else by its bytes.

    What a page says in `<time>`, how long something took, does not count.
    """
    if path.suffix == ".html":
        return hashlib.sha256(CLOCK.sub(b"", path.read_bytes())).hexdigest()
    if path.suffix == ".parquet":
        return _table_digest(read(path))
    if path.suffix == ".safetensors":
        total = hashlib.sha256()
        for name, array in sorted(read(path).items()):
            total.update(f"{name}\0{array.dtype.str}\0{array.shape}\0".encode())
            total.update(np.ascontiguousarray(array).data)
        return total.hexdigest()
    return file_digest(path)


def file_digest(path: Path) -> str:
    """SHA-256 of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def canonical(value: Any) -> bytes:
    """JSON with sorted keys, so that equal values are equal bytes. Dataclasses, mappings and numpy values are taken apart.

    Raises:
        ValueError: a number is not finite; JSON cannot say it, so a stage must write None and mean it.
    """
    return (json.dumps(plain(value), sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def plain(value: Any, where: str = "") -> Any:
    """Dataclasses, mappings, tuples, numpy values and paths as what JSON has."""
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value), where)
    if isinstance(value, Mapping):
        return {str(key): plain(item, f"{where}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, f"{where}[{i}]") for i, item in enumerate(value)]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist(), where)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"JSON value at {where or 'the top'} is {value}; expected a finite number or None")
    return value


def _table_digest(table: Any) -> str:
    total = hashlib.sha256()
    for name, column in zip(table.column_names, table.columns, strict=True):
        total.update(f"{name}\0{column.type}\0{len(column)}\0".encode())
        array = column.combine_chunks()
        for chunk in array.chunks if hasattr(array, "chunks") else [array]:
            _column_digest(chunk, total)
    return total.hexdigest()


def _column_digest(array: Any, total: Any) -> None:
    import pyarrow as pa
    import pyarrow.compute as pc

    kind = array.type
    if pa.types.is_dictionary(kind):
        array, kind = array.dictionary_decode(), kind.value_type
    total.update(np.packbits(array.is_valid().to_numpy(zero_copy_only=False)))
    if pa.types.is_struct(kind):
        for child in array.flatten():
            _column_digest(child, total)
    elif pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind):
        total.update(_numbers(pc.call_function("list_value_length", [array])))
        _column_digest(array.flatten(), total)
    elif pa.types.is_string(kind) or pa.types.is_binary(kind) or pa.types.is_large_string(kind) or pa.types.is_large_binary(kind):
        total.update(_numbers(pc.call_function("binary_length", [array])))
        total.update(b"".join(v if isinstance(v, bytes) else v.encode() for v in array.drop_null().to_pylist()))
    elif not pa.types.is_null(kind):
        total.update(_numbers(array))


def _numbers(array: Any) -> np.ndarray:
    return np.ascontiguousarray(array.drop_null().to_numpy(zero_copy_only=False)).view(np.uint8)
