"""MuJoCo ships compiled modules without stubs; the type checker takes what it finds there as it is."""

from typing import Any

def __getattr__(name: str) -> Any: ...
