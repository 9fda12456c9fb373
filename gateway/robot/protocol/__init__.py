"""HexapodProtocol v1.0.0: frames and framing, pure functions of bytes."""

from typing import Final

VERSION: Final = "1.0.0"
