"""When a diagnosis begins no further step: after a time, or once the user has interrupted it."""

import time as clock


class Deadline:
    """True when called once the time is up.

    Parameters
    ----------
    seconds
        From now on.
    whole
        The time that this is a part of, which ends with it where it is stopped.
    """

    def __init__(self, seconds: float = float("inf"), whole: "Deadline | None" = None):
        self.end, self.whole = clock.monotonic() + seconds, whole

    def __call__(self) -> bool:
        """Whether the time is up."""
        return clock.monotonic() > self.end

    def part(self, share: float) -> "Deadline":
        """A share of what is left of the time."""
        left = self.end - clock.monotonic()
        return Deadline(share * left, self)

    def stop(self) -> None:
        """End the time now."""
        self.end = -float("inf")
        if self.whole is not None:
            self.whole.stop()


NEVER = Deadline()
