"""Whether this process was started by torchrun beside others; torch is imported only where it was."""

import os
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def joined() -> Iterator[int]:
    """This process' number among those that train together; 0 leads, and is alone where torchrun started none."""
    if os.environ.get("WORLD_SIZE", "1") == "1":
        yield 0
        return
    from edream.learn import ranks

    with ranks.joined() as rank:
        yield rank
