"""Driver: motors and sensors of motion, as the controlling process sees them; the contract for whoever writes one."""

from __future__ import annotations

from typing import Protocol

from .interfaces import Command, Measurement

COMMAND_TIMEOUT = 0.1
"""Longest time [s] from one command to the next: then the driver stops the motors by itself."""


class Driver(Protocol):
    """Motors and sensors of one robot. Every driver promises the following, and safety rests on it.

    - Clock. All times are seconds on the clock of the caller; readings are stamped with the time at which they were
      measured, not with that of their arrival.
    - No call blocks. What cannot be sent or read at once is left out, and ``measure`` and ``send`` take less than a
      tenth of a control period.
    - Command timeout. Where no command has come for :data:`COMMAND_TIMEOUT`, by the time that it was sent with, the
      driver stops all motors at full deceleration by itself: the process that commands may have been killed or stopped.
      So something that outlives that process has to do this: the motor controllers, or another process. Commands are
      obeyed again as soon as they come.
    - Safe stop. ``Command.stop`` cuts the motors' power and lets the brakes fall in, whatever the speeds say, for as
      long as it is commanded.
    - Nothing lost. Wheel travel is summed up from one ``measure`` that returns a measurement to the next, however long
      that takes and whatever is dropped on the way; where some of it is unknown, ``drive`` is None. A localization fix
      is reported once, with the time at which it was measured; where several have come, the newest.
    - Emergency stop. A pressed button stops the motors by itself, without the caller; it is reported in
      ``Measurement.emergency`` for as long as it is pressed. So is a felt contact in ``Measurement.contact``, in one
      measurement at least.
    - No NaN. A command of the wrong size, or one that is not finite, is refused and not passed on.

    A driver may have a method ``open()`` besides: an executor's process calls it once, before time begins. What takes
    long, such as opening a bus and waiting for its first word, belongs there; in the first ``measure`` it would cost
    control periods. And a method ``notes()``: what it has left out of what came since the last call, in words, for the
    log; and where a guard's process has it, ``desired(t)``: what somebody wants the robot to do.
    """

    def measure(self, t: float) -> Measurement | None:
        """The measurement since the last call.

        Args:
            t: now [s].

        Returns:
            The newest readings, with the travel since the last measurement that was returned; None where nothing came.

        Raises:
            Exception: whatever a sensor's driver throws; the caller treats it as a missing measurement.
        """
        ...

    def send(self, t: float, command: Command) -> None:
        """Pass on a command; it holds until the next one, or until the timeout.

        Args:
            t: now [s].
            command: speeds of the motors.

        Raises:
            ParameterError: it has the wrong size or is not finite.
        """
        ...

    def close(self) -> None:
        """Stop safely, and release the driver's resources; calls after that do nothing."""
        ...
