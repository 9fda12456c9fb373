"""The velocity of held keys: a terminal reports presses and repetitions of a key, never its release. Pure."""

from typing import Final

from gateway.people.walking import STILL, Velocity

PRESSED_S: Final = 0.7
"""How long a key counts when it is pressed: until the terminal repeats it, which takes up to 0.66 s (X11's default)."""
REPEATED_S: Final = 0.2
"""How long it counts after a repetition; these come every 30 to 90 ms."""
SPEEDS: Final = (0.02, 0.04, 0.06, 0.08, 0.1, 0.12)
"""m/s; the turning goes with it."""
_TURN: Final = 4.0
"""rad/s for each m/s."""
_DIRECTIONS: Final = {
    "w": Velocity(1, 0, 0),
    "up": Velocity(1, 0, 0),
    "s": Velocity(-1, 0, 0),
    "down": Velocity(-1, 0, 0),
    "a": Velocity(0, 1, 0),
    "d": Velocity(0, -1, 0),
    "left": Velocity(0, 0, _TURN),
    "right": Velocity(0, 0, -_TURN),
}


class Keypad:
    """The velocity of the key that was pressed last, for as long as it counts."""

    def __init__(self) -> None:
        self._key = ""
        self._until_s = 0.0
        self._speed = SPEEDS.index(0.06)

    @property
    def speed_m_s(self) -> float:
        """The speed that a held key commands."""
        return SPEEDS[self._speed]

    def press(self, key: str, now_s: float) -> bool:
        """Take a key. Returns whether it belongs to the pad; any other key releases the held one."""
        key = key.lower()
        if key in ("+", "=", "-"):
            self._speed = max(0, min(len(SPEEDS) - 1, self._speed + (-1 if key == "-" else 1)))
            return True
        if key not in _DIRECTIONS:
            self.release()
            return False
        repeated = key == self._key and now_s < self._until_s
        self._key = key
        self._until_s = now_s + (REPEATED_S if repeated else PRESSED_S)
        return True

    def release(self) -> None:
        """From now on no key is held."""
        self._key = ""

    def velocity(self, now_s: float) -> Velocity:
        """The velocity that the held keys command now."""
        if not self._key or now_s >= self._until_s:
            return STILL
        return _DIRECTIONS[self._key].times(self.speed_m_s)
