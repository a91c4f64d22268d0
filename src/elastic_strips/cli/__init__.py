"""Command line: ``elastic-strips run | view | bench | list``."""

from .main import main

__all__ = ["main"]
