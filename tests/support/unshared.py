"""What an SPI device of a test's own has in common with every other: nobody else uses it."""

from gateway.robot.spi import Batch


class UnsharedDevice:
    """A device without its transfers: no lock is needed, no `stop-servos` is at work, and closing releases nothing."""

    most_transfers = 32

    def take(self, data: bytes) -> None:
        """One transfer of a batch. Raises SpiError: then the rest of the batch does not come."""
        raise NotImplementedError

    def transfer(self, batch: Batch) -> None:
        for data, _ in batch:
            self.take(data)

    def fileno(self) -> None:
        pass

    def stop_servos_at_work(self) -> bool:
        return False

    def close(self) -> None:
        pass
