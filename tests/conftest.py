"""Fixtures that every test may use."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real measurements: EDREAM_SHARED_DATA, or `shared/data` beside the checkout; without it, tests are skipped."""
    folder = Path(os.environ.get("EDREAM_SHARED_DATA") or ROOT.parent / "shared" / "data")
    if os.environ.get("EDREAM_SHARED_DATA") and not folder.is_dir():
        pytest.fail(f"EDREAM_SHARED_DATA names no folder: {folder}", pytrace=False)
    if not folder.is_dir():
        pytest.skip(f"real measurements are not here: no folder {folder}; set EDREAM_SHARED_DATA")
    return folder


@pytest.fixture(scope="session")
def root() -> Path:
    """The checkout."""
    return ROOT


@pytest.fixture(scope="session")
def rendering() -> None:
    """Skips a test where nothing can be rendered."""
    from tests.rendering import why_not

    reason = why_not()
    if reason:
        pytest.skip(reason)
