"""Plans for drives whose time is simulated: the drive does not go on while one is made, on a slow machine neither."""

from __future__ import annotations

from elastic_strips.sim.computing import ChargedExecutor, Computing
from elastic_strips.work import bounded_by_work


class _PlanningAtOnce(ChargedExecutor):
    def submit(self, fn, /, *args, **kwargs):
        with bounded_by_work():
            return super().submit(fn, *args, **kwargs)


def planning_at_once():
    """What runs a controller's plans: each is there as soon as it is asked for, and its limits of time are of work."""
    return _PlanningAtOnce(Computing(), lambda: 0.0)
