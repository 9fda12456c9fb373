"""Where each servo was commanded to be, as a table for spreadsheets (CSV)."""

import csv
from pathlib import Path

from gateway.people.ros2.commanded import CommandedJoints
from schemas.robot import SERVO_IDS


class Table:
    """A row for each frame and each state: seconds since 1970, and degrees; empty where a servo is off."""

    def __init__(self, path: Path, *, overwrite: bool) -> None:
        """Raises FileExistsError, OSError."""
        self._file = path.open("w" if overwrite else "x", newline="", encoding="ascii")
        self._writer = csv.writer(self._file)
        self._writer.writerow(["time_s", *(f"servo_{servo_id}_deg" for servo_id in SERVO_IDS)])

    def add(self, joints: CommandedJoints, time_ns: int) -> None:
        """One row."""
        angles = (joints.deg.get(each) if joints.running.get(each) else None for each in SERVO_IDS)
        self._writer.writerow([f"{time_ns / 1e9:.6f}", *angles])

    def flush(self) -> None:
        """Hand all to the kernel. Raises OSError."""
        self._file.flush()

    def close(self) -> None:
        """Raises OSError."""
        self._file.close()
