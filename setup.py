"""What pyproject.toml cannot state: a wheel has the files of the console's page compressed, too."""

import gzip
from pathlib import Path
from typing import Final

from setuptools import setup
from setuptools.command.build_py import build_py

PAGE: Final = "gateway/people/console/page"
PACKED: Final = (".css", ".html", ".js", ".svg", ".webmanifest")


class WithPackedPage(build_py):
    """Beside each text file of the page its gzip, which the console sends."""

    def run(self) -> None:
        super().run()
        if self.editable_mode:
            return
        for path in Path(self.build_lib, PAGE).rglob("*"):
            if path.suffix in PACKED:
                packed = gzip.compress(path.read_bytes(), mtime=0)
                path.with_name(f"{path.name}.gz").write_bytes(packed)


setup(cmdclass={"build_py": WithPackedPage})
