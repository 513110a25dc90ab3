"""MuJoCo as a search wants it: it says nothing of simulations that become unstable, and does not time its steps."""

import ctypes
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import mujoco

log = logging.getLogger(__name__)
_lock, _disturbed = threading.Lock(), []  # what MuJoCo called before, then one entry a simulation


@contextmanager
def quiet() -> Iterator[None]:
    """MuJoCo neither prints nor writes a log file when a simulation becomes unstable, nor reads the clock.

    A search tries unstable numbers, too. MuJoCo's stopwatch, read many times a step, takes a sixth of a robot arm's step;
    `MjData.timer` then counts steps alone. MuJoCo asks the function that `mjcb_time` points to, or none; `set_mjcb_time(None)`
    would put the bindings' own clock there, so the pointer itself is cleared. Where several threads simulate, the last
    of them puts back what was there before the first.
    Source: MuJoCo API reference, globals, mju_user_warning and mjcb_time.
    """
    clock = _clock()
    with _lock:
        if not _disturbed:
            _disturbed.append((mujoco.get_mju_user_warning(), clock.value))
            mujoco.set_mju_user_warning(log.debug)
            clock.value = None
        _disturbed.append(None)
    try:
        yield
    finally:
        with _lock:
            _disturbed.pop()
            if len(_disturbed) == 1:
                warning, clock.value = _disturbed.pop()
                mujoco.set_mju_user_warning(warning)


@cache
def _clock() -> ctypes.c_void_p:
    """MuJoCo's pointer to the function that tells the time."""
    package = Path(mujoco.__file__).parent
    library = next(path for path in sorted(package.iterdir()) if _is_engine(path.name))
    return ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mjcb_time")


def _is_engine(name: str) -> bool:
    """Whether a file of MuJoCo's package is its shared library, on any system."""
    return name.removeprefix("lib").startswith("mujoco.") and any(end in name for end in (".so", ".dylib", ".dll"))
