"""The power board's bytes on classic CAN: requests and answers. Pure.

| request                | answer | data of the answer, big endian                                            |
|------------------------|--------|---------------------------------------------------------------------------|
| 6A mask                | 6B     | the mask of 18 bits; bit n - 1 feeds the servo on output n                |
| 64                     | 65     | the newest error, the next one at the next 64; none: no bytes (see below) |
| 96                     | 97     | none; the error shown last is deleted                                     |
| 70, 72, 74, 76, 78, 7A | + 1    | currents of outputs 1-3, 4-6, … 16-18: three uint16, mA                   |
| 7C, 7E                 | + 1    | currents manipulator, 5 V, 3.3 V; standby, supply: uint16, mA             |
| 80, 82, 84             | + 1    | converters 1-3; 4 and 5; supply and battery: uint16, mV                   |
| 86                     | 87     | three temperatures: int16, °C                                             |
| -                      | 69     | none; the off button was pressed                                          |

| error (65)              | data                                                                              |
|-------------------------|-----------------------------------------------------------------------------------|
| converter overcurrent   | 01, mask of converters (bit 0: converter 1)                                        |
| servo overcurrent       | 02, mask of outputs, as in 6B                                                      |
| overtemperature         | 04, mask of converters: sensor 1 switches off 07, sensor 2 10, sensor 3 08          |
| supply too low          | 08                                                                                |
| cannot be read          | anything else; it may concern any output                                          |

65 is also sent unasked: at each new error, and every 140 ms while it is too hot. The board answers all requests except
6A in its receive interrupt. The firmware decides, not its DBC file, which numbers the mask's bits differently.
"""

import struct
from typing import Final, NamedTuple

OUTPUTS: Final = 18
ALL: Final = (1 << OUTPUTS) - 1
"""The mask that feeds all outputs."""


class CanFrame(NamedTuple):
    """A classic CAN frame with an identifier of 11 bits."""

    id: int
    data: bytes = b""


SET_SUPPLY: Final = 0x6A
SUPPLIED: Final = 0x6B
ERROR: Final = 0x65
CLEARED: Final = 0x97
GOING_OFF: Final = 0x67
OFF_PRESSED: Final = 0x69

MANIPULATOR_5V_3V3_MA: Final = 0x7C
STANDBY_SUPPLY_MA: Final = 0x7E
CONVERTERS_1_TO_3_MV: Final = 0x80
CONVERTERS_4_5_MV: Final = 0x82
SUPPLY_BATTERY_MV: Final = 0x84
TEMPERATURES_C: Final = 0x86
_LAYOUTS: Final = {
    **dict.fromkeys((0x70, 0x72, 0x74, 0x76, 0x78, 0x7A), struct.Struct(">3H")),
    MANIPULATOR_5V_3V3_MA: struct.Struct(">3H"),
    STANDBY_SUPPLY_MA: struct.Struct(">2H"),
    CONVERTERS_1_TO_3_MV: struct.Struct(">3H"),
    CONVERTERS_4_5_MV: struct.Struct(">2H"),
    SUPPLY_BATTERY_MV: struct.Struct(">2H"),
    TEMPERATURES_C: struct.Struct(">3h"),
}
ASK_ERROR: Final = CanFrame(0x64)
CLEAR_ERROR: Final = CanFrame(0x96)
ASK_CURRENTS: Final = tuple(map(CanFrame, _LAYOUTS))[:6]
ASK_RAILS: Final = tuple(map(CanFrame, _LAYOUTS))[6:]

CONVERTER_OVERCURRENT: Final = 1
SERVO_OVERCURRENT: Final = 2
OVERTEMPERATURE: Final = 4
SUPPLY_LOW: Final = 8
"""Codes of errors."""


class BoardValues(NamedTuple):
    """The answer to a question about currents or rails: the question's identifier, and values in mA, mV or °C."""

    question: int
    values: tuple[int, ...]


class BoardError(NamedTuple):
    """An error of the board: its code, a sentence, and the mask of outputs without supply until it is deleted."""

    code: int
    why: str
    outputs: int


UNREADABLE: Final = BoardError(0, "the power board reports an error that cannot be read", ALL)
Answer = int | BoardValues | BoardError | CanFrame
"""An int is the mask of fed outputs. A CanFrame is an answer without data: ERROR (none is left), CLEARED (the error
shown last), OFF_PRESSED, or GOING_OFF (in 1 s the whole robot is switched off)."""
_ERROR_BYTES: Final = {CONVERTER_OVERCURRENT: 2, SERVO_OVERCURRENT: 4, OVERTEMPERATURE: 2, SUPPLY_LOW: 1}
_CONVERTERS: Final = (1 << 5) - 1
OUTPUTS_OF_CONVERTER: Final = (0b111111, 0b111111 << 6, 0b111111 << 12, 0, 0)
"""Converters 4 and 5 feed no servo."""


def set_supply(mask: int) -> CanFrame:
    """Return the request to feed these outputs and no others. Raises ValueError beyond 18 bits."""
    if not 0 <= mask <= ALL:
        raise ValueError(f"mask {mask:#x}; the board has {OUTPUTS} outputs")
    return CanFrame(SET_SUPPLY, mask.to_bytes(3, "big"))


def mask_of(frame: CanFrame) -> int | None:
    """Return the mask of a 6A or 6B; None: another frame, another length, or a bit that no output has."""
    if frame.id not in (SET_SUPPLY, SUPPLIED) or len(frame.data) != 3:
        return None
    mask = int.from_bytes(frame.data, "big")
    return mask if mask <= ALL else None


def read(frame: CanFrame) -> Answer | None:
    """Return the answer in a frame; None if the frame is not the board's, or does not fit the table."""
    identifier, data = frame
    match identifier:
        case 0x6B:
            return mask_of(frame)
        case 0x65:
            return _error(data) if data else frame
        case 0x97 | 0x69 | 0x67:
            return None if data else frame
    layout = _LAYOUTS.get(identifier - 1)
    if layout is None or len(data) != layout.size:
        return None
    return BoardValues(identifier - 1, layout.unpack(data))


def _error(data: bytes) -> BoardError:  # mutants accepted (Step): no error has a sixth bit
    code, mask = data[0], int.from_bytes(data[1:], "big")
    most = ALL if code == SERVO_OVERCURRENT else _CONVERTERS
    if len(data) != _ERROR_BYTES.get(code) or mask > most:
        return UNREADABLE
    if code == SERVO_OVERCURRENT:
        return BoardError(code, "overcurrent: the power board has switched these servos off", mask)
    if code == SUPPLY_LOW:
        return BoardError(code, "the power board's supply is too low", 0)
    numbers = [number for number in range(1, 6) if mask >> (number - 1) & 1]
    cause = "overcurrent" if code == CONVERTER_OVERCURRENT else "overtemperature"
    why = f"{cause}: the power board has switched off its converter {' and '.join(map(str, numbers))}"
    return BoardError(code, why, sum(OUTPUTS_OF_CONVERTER[number - 1] for number in numbers))
