"""Starts the process that simulates the power board, from within the gateway's."""

from collections.abc import Sequence
from pathlib import Path

from gateway.host.shared_page import SensedPage, ServoPage
from gateway.onboard.simulation_process import SimulationProcess, private_folder


class BoardProcess(SimulationProcess):
    """The process; its board answers on `channel` when the constructor returns, with all servos off."""

    name = "power board's"
    lost = "nobody simulates the power board any more, so it does not answer"

    def __init__(
        self,
        outputs: Sequence[int],
        page: ServoPage | None = None,
        sensed: SensedPage | None = None,
        record: Path | None = None,
    ) -> None:
        """`outputs`: the servo on each. `page`: where a simulated controller sends its servos; a new one by default.
        `sensed`: what a simulated body feels, whose torques decide the currents. `record`: a file for all frames."""
        self.page = ServoPage() if page is None else page
        """For the simulated controller: it says which servos are fed."""
        pages = [self.page.fd] if sensed is None else [self.page.fd, sensed.fd]
        given = {
            "outputs": list(outputs),
            "page": self.page.fd,
            "sensed": None if sensed is None else sensed.fd,
            "record": None if record is None else str(record),
        }
        folder = private_folder("power")
        self.channel = str(folder / "can")
        """The serial device for python-can's `slcan`."""
        super().__init__("gateway.robot.power.simulator", given, pages, folder, self.channel)
