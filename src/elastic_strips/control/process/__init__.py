"""Process: the control loop in a process of its own: the process, what runs in it, and the lines between them."""

from __future__ import annotations

from .executor_process import ExecutorProcess
from .log_stream import read_log

__all__ = ["ExecutorProcess", "read_log"]
