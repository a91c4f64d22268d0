"""Control room: the paper's hybrid control: deliberative, sequencing and reactive layer."""

from __future__ import annotations

from .task_watch import TaskEvent, TaskState, TaskWatch

__all__ = ["TaskEvent", "TaskState", "TaskWatch"]
