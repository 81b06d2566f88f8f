"""A watchdog in software: it resets nothing, but says that its time ran out."""

from hal.clock import Clock


class SoftWatchdog:
    """Expires when it was not served for longer than timeout_ns, and stays so until it is armed again.

    clock: its own oscillator; a clock whose mission time may jump is the wrong one, for a jump is no hang.
    """

    def __init__(self, clock: Clock, timeout_ns: int) -> None:
        self._clock, self._timeout_ns = clock, timeout_ns
        self.arm()

    def arm(self) -> None:
        """Begin anew, as after a reset of the processor."""
        self._served_ns = self._clock.now_ns()
        self._expired = False

    def serve(self) -> None:
        """Start its time again; too late is too late."""
        self._expired = self.expired()
        self._served_ns = self._clock.now_ns()

    def expired(self) -> bool:
        """Its time ran out, now or before it was served."""
        return self._expired or self._clock.now_ns() - self._served_ns > self._timeout_ns
