"""Command line: ``elastic-strips run | drive | view | bench | list``."""

from .main import main

__all__ = ["main"]
