"""A computer's /proc and /sys below a folder, as Linux lays them out for a spidev."""

import struct
from pathlib import Path

PI_4 = "Linux version 6.6.31+rpt-rpi-v8 (serge@raspberrypi.com) (gcc-12 (Debian 12.2.0-14+deb12u1) 12.2.0, GNU ld) "
OF_MAY = "#1 SMP PREEMPT Debian 1:6.6.31-1+rpt1 (2024-05-29)\n"
GPIOS = struct.pack(">6I", 7, 8, 1, 7, 7, 1)
"""`cs-gpios = <&gpio 8 1>, <&gpio 7 1>`: a phandle, a pin and flags for each chip select."""


class MachineTree:
    """A Raspberry Pi 4 with spidev0.0 and spidev0.1, both of spidev; a test changes what it wants."""

    def __init__(
        self,
        root: Path,
        *,
        driver: str | None = "spi-bcm2835",
        cs_gpios: bytes | None = GPIOS,
        model: str = "Raspberry Pi 4 Model B Rev 1.4",
        version: str = PI_4 + OF_MAY,
        node: str = "soc/spi@7e204000",
    ) -> None:
        self.root = root
        self.drivers = root / "sys/bus/drivers"
        self.node = root / "sys/firmware/devicetree/base" / node
        self.node.mkdir(parents=True)
        if cs_gpios is not None:
            (self.node / "cs-gpios").write_bytes(cs_gpios)
        controller = root / "sys/devices/platform/soc/fe204000.spi"
        self.bus = controller / "spi_master/spi0"
        self.bus.mkdir(parents=True)
        (controller / "of_node").symlink_to(self.node)
        if driver is not None:
            self._bind(controller, driver)
        self.add("spi0.0", "spidev")
        self.add("spi0.1", "spidev")
        device = root / "sys/class/spidev/spidev0.0"
        device.mkdir(parents=True)
        (device / "device").symlink_to(self.bus / "spi0.0")
        (root / "proc").mkdir()
        (root / "proc/device-tree").symlink_to(root / "sys/firmware/devicetree/base")
        (root / "proc/device-tree/model").write_text(f"{model}\0")
        (root / "proc/version").write_text(version)

    def add(self, name: str, driver: str | None) -> Path:
        folder = self.bus / name
        folder.mkdir(exist_ok=True)
        (folder / "driver").unlink(missing_ok=True)
        if driver is not None:
            self._bind(folder, driver)
        return folder

    def _bind(self, folder: Path, driver: str) -> None:
        (self.drivers / driver).mkdir(parents=True, exist_ok=True)
        (folder / "driver").symlink_to(self.drivers / driver)
