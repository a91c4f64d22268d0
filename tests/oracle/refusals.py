"""What a constructor ought to refuse: many values in one test, and those that it took by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from elastic_strips.errors import ParameterError


def taken(make: Callable[..., object], given: Iterable[dict[str, object]]) -> list[str]:
    """Keyword arguments that were taken, or refused without naming one of them; none where all is well."""
    found = []
    for arguments in given:
        text = ", ".join(f"{name}={value!r}" for name, value in arguments.items())
        try:
            make(**arguments)
        except ParameterError as error:
            if not any(name in str(error) for name in arguments):
                found.append(f"{text}: refused as {error}")
        else:
            found.append(f"{text}: taken")
    return found
