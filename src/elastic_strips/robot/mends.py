"""What a robot's files get wrong without harm: mended, and said in one warning for each kind of fault."""

from __future__ import annotations

import logging
from pathlib import Path

_log = logging.getLogger(__name__)
_SHOWN = 12


class Mends:
    """Faults of one file, counted by kind."""

    def __init__(self, source: Path) -> None:
        self._source = source
        self._found: dict[str, list[str]] = {}

    def add(self, kind: str, name: object) -> None:
        """Note a fault: its kind, in words that follow a count ("links that the robot has not"), and whose it is."""
        names = self._found.setdefault(kind, [])
        if repr(name) not in names:
            names.append(repr(name))

    def say(self) -> None:
        """Log one warning for each kind of fault, with the names."""
        for kind, names in self._found.items():
            more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            _log.warning("%s: %d %s: %s%s", self._source, len(names), kind, ", ".join(names[:_SHOWN]), more)
