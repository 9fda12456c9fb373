"""What a `with` closes."""

from typing import Self


class Closing:
    """Its `close` is called at the end of a `with`, however that ends."""

    def close(self) -> object:
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
