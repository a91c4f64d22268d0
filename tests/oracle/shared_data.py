"""Where the benchmark files lie that are not part of the project."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[2]


def shared_data(*names: str) -> Path:
    """A file or folder of the shared data; skips the test where it is missing.

    It is looked for in the folder that ``ELASTIC_STRIPS_DATA`` names, else in ``../shared/data`` beside the checkout.
    """
    folder = Path(os.environ.get("ELASTIC_STRIPS_DATA", CHECKOUT.parent / "shared" / "data"))
    path = folder.joinpath(*names)
    if not path.exists():
        pytest.skip(f"{path} is missing: set ELASTIC_STRIPS_DATA to the folder that holds {names[0]!r}")
    return path
