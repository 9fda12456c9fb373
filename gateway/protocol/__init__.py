"""HexapodProtocol v1.0.0: frames and framing, pure functions of bytes."""
