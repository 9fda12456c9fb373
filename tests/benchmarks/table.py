"""The benchmark's results: one row a figure, as text for a terminal."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """One figure of the gateway, the naive script's beside it, the aim, and whether it is met (None: no aim)."""

    name: str
    gateway: str
    naive: str
    aim: str = ""
    met: bool | None = None

    @property
    def cells(self) -> tuple[str, ...]:
        verdict = {True: "met", False: "NOT MET", None: ""}[self.met]
        return self.name, self.gateway, self.naive, self.aim, verdict


HEAD = ("figure", "gateway", "naive script", "aim", "")


def as_text(rows: list[Row]) -> str:
    """Columns that line up."""
    cells = [HEAD, *(row.cells for row in rows)]
    widths = [max(len(line[column]) for line in cells) for column in range(len(HEAD))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in cells]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:]])


def microseconds(value_us: float) -> str:
    """µs while that is short, else ms."""
    return f"{value_us:.0f} µs" if value_us < 10_000 else f"{value_us / 1000:,.0f} ms"
