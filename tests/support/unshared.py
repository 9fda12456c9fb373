"""What an SPI device of a test's own has in common with every other: nobody else uses it."""

from contextlib import AbstractContextManager, nullcontext


class UnsharedDevice:
    """A device without its transfers: no lock is needed, no `stop-servos` is at work, and closing releases nothing."""

    def lock(self) -> AbstractContextManager[None]:
        return nullcontext()

    def stop_servos_at_work(self) -> bool:
        return False

    def close(self) -> None:
        pass
